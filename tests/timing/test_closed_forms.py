"""Closed form = recursion = an independent discrete-event simulation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import norm

from scanhsi.timing.bounds import (
    LineDelays,
    earliest,
    mean_period_ns,
    price_of_buffers,
    price_of_mode,
)
from scanhsi.timing.buffers import buffers_for_stall, longest_lateness_s
from scanhsi.timing.closed_forms import (
    MODES,
    Layout,
    circuits,
    critical,
    gains_s,
    latency_s,
    line_period_s,
    scan_s,
)
from scanhsi.timing.model import Terms
from support.discrete_events import Scan

modes = st.sampled_from(MODES)
layouts = st.builds(
    Layout, overlap=st.booleans(), buffers=st.integers(1, 4), line_buffers=st.sampled_from([1, 2, 3, 4, 5, 6])
)
ticks = st.integers(0, 12)
"""Delays in units of an odd number of ns: few enough that a schedule settles within some hundred lines, all kinds of ties."""


@st.composite
def all_terms(draw: st.DrawFn) -> Terms:
    unit_s = draw(st.integers(100_000, 3_000_000)) * 1e-9
    names = [name for name in Terms.names() if name != "T_exp"]
    return Terms(
        T_exp_s=draw(st.integers(1, 12)) * unit_s,
        **{f"{name}_s": draw(ticks) * unit_s for name in names},
    )


def delays(n: int, terms: Terms, layout: Layout) -> LineDelays:
    def column(*names: str) -> np.ndarray:
        return np.full(n, sum(round(terms.get(name) * 1e9) for name in names), np.int64)

    return LineDelays(
        exposure=column("T_exp"),
        actuate=column("T_rand", "T_act", "settle"),
        trigger=column("T_trig"),
        transfer=column("T_rx", "T_api"),
        copy=column("T_mcpy"),
        store=column("T_store"),
        event=column("T_ev"),
        readout_ns=round(terms.T_rd_s * 1e9),
        dead_ns=round(terms.T_dead_s * 1e9),
        first_row_ns=round(terms.t1_s * 1e9),
        overlap=layout.overlap,
        buffers=layout.buffers,
        line_buffers=layout.line_buffers,
        whole_frame=True,
    )


@settings(max_examples=500, deadline=None)
@given(terms=all_terms(), mode=modes, layout=layouts)
def test_closed_form_is_the_period_of_the_recursion_and_of_simpy(terms: Terms, mode: str, layout: Layout) -> None:
    few = delays(24, terms, layout)
    schedule, simulated = earliest(few, mode), Scan(few, mode).run()
    assert simulated.starts.tolist() == schedule.starts.tolist()  # to the ns, from line 0 on
    assert simulated.stored.tolist() == schedule.stored.tolist()
    window = 60  # lines: a multiple of every number of buffers, with which a schedule bound by buffers repeats
    stored = earliest(delays(1500, terms, layout), mode).stored
    settled_s = float(stored[-1] - stored[-1 - window]) / window * 1e-9
    assert settled_s == pytest.approx(line_period_s(terms, mode, layout), abs=1e-9, rel=0)


@settings(max_examples=200, deadline=None)
@given(data=st.data(), mode=modes, layout=layouts, terms=all_terms())
def test_random_delays_give_the_same_schedule_in_simpy(
    data: st.DataObject, mode: str, layout: Layout, terms: Terms
) -> None:
    n = 30
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32)))
    base = delays(n, terms, layout)
    stalls = rng.random(n) < 0.1
    drawn = replace(
        base,
        actuate=base.actuate + rng.integers(0, 10_000_000, n),
        trigger=base.trigger + rng.integers(0, 1_000_000, n),
        transfer=base.transfer + rng.integers(0, 10_000_000, n),
        copy=base.copy + rng.integers(0, 5_000_000, n),
        store=base.store + rng.integers(0, 5_000_000, n) + stalls * 80_000_000,
        event=base.exposure * 0 + rng.integers(0, 1_000_000, n),
    )
    schedule, simulated = earliest(drawn, mode), Scan(drawn, mode).run()
    assert simulated.starts.tolist() == schedule.starts.tolist()
    assert simulated.stored.tolist() == schedule.stored.tolist()


DEVICE = (
    Terms(  # another split of the paper's overhead, with every term of the schedule: ms as in the timing literature
        T_exp_s=0.1,
        T_rx_s=18.16e-3,
        T_mcpy_s=0.5e-3,
        T_act_s=10e-3,
        T_ev_s=0.5e-3,
        T_trig_s=0.5e-3,
        T_rd_s=20.2e-3,
        t1_s=0.2e-3,
        T_store_s=2.5e-3,
        T_rand_s=1e-3,
    )
)
RX_MS = {"8": 18.16, "12p": 27.24, "12u": 36.3}


@pytest.mark.parametrize(
    ("exposure_ms", "pixels", "mode", "overlap", "period_ms"),
    [
        (10, "8", "sequential", True, 45.2),
        (10, "8", "stepped", False, 30.2),
        (10, "12u", "stepped", True, 36.3),
        (20, "8", "stepped", True, 31.0),
        (20, "12p", "continuous", True, 27.24),
        (50, "12u", "stepped", False, 70.2),
        (100, "8", "sequential", True, 135.2),
        (100, "12p", "sequential", True, 142.44),
        (100, "12u", "stepped", True, 111.0),
        (100, "12u", "continuous", True, 100.0),
    ],
)
def test_table_of_the_papers_device(
    exposure_ms: float, pixels: str, mode: str, overlap: bool, period_ms: float
) -> None:
    # These reference values take the disturbance in sequential scans only, and T_ev too, which here hides behind the transfer.
    terms = replace(DEVICE, T_exp_s=exposure_ms * 1e-3, T_rx_s=RX_MS[pixels] * 1e-3)
    changes = {"T_trig_s": 1e-3, "T_ev_s": 0.0} if mode == "sequential" else {"T_rand_s": 0.0}
    terms = replace(terms, **changes)
    assert line_period_s(terms, mode, Layout(overlap)) * 1e3 == pytest.approx(period_ms, abs=1e-9)


def test_the_critical_circuit_names_what_to_improve() -> None:
    layout = Layout()
    slow_link = replace(DEVICE, T_exp_s=0.01, T_rx_s=36.3e-3)
    assert critical(slow_link, "stepped", layout).terms == ("T_rx", "T_api")
    gains = gains_s(slow_link, "stepped", layout)
    assert gains["T_rx"] == pytest.approx(1e-3)
    assert gains["T_act"] == 0
    assert "T_api" not in gains  # it is 0 already
    assert gains_s(DEVICE, "stepped", layout)["T_act"] == pytest.approx(1e-3)
    assert gains_s(DEVICE, "stepped", layout)["T_ev"] == pytest.approx(0.5e-3)  # there is no more of it
    assert critical(DEVICE, "continuous", layout).name == "exposure"
    in_turn = gains_s(DEVICE, "sequential", layout)
    assert in_turn["T_rx"] == 0  # hidden behind the read-out
    assert in_turn["T_rd"] == pytest.approx(1e-3)


@given(terms=all_terms(), layout=layouts, mode=modes)
def test_the_makespan_is_the_periods_and_the_latency(terms: Terms, layout: Layout, mode: str) -> None:
    wide = replace(layout, buffers=50, line_buffers=50)
    stored = earliest(delays(40, terms, wide), mode).stored
    told = scan_s(40, line_period_s(terms, mode, wide), latency_s(terms, mode))
    assert stored[-1] * 1e-9 == pytest.approx(told, abs=1e-7)


def test_prices() -> None:
    few = delays(400, replace(DEVICE, T_exp_s=0.02, T_rand_s=0.0), Layout(buffers=1, line_buffers=1))
    assert price_of_mode(replace(few, buffers=9, line_buffers=9), "stepped") == pytest.approx(31.0 / 20.2, rel=0.01)
    assert price_of_mode(few, "continuous") == 1
    assert price_of_buffers(replace(few, buffers=2, line_buffers=2), "stepped") == pytest.approx(1.0, abs=1e-3)
    assert price_of_buffers(few, "stepped") == pytest.approx(43.7 / 31.0, rel=0.01)  # one buffer: all but in turn


@settings(deadline=None)
@given(
    stall_ms=st.lists(st.integers(0, 400), min_size=0, max_size=5),
    store_ms=st.floats(0.1, 10),
    exposure_ms=st.integers(15, 60),
    seed=st.integers(0, 1000),
)
def test_the_sizing_rule_removes_the_loss(stall_ms: list[int], store_ms: float, exposure_ms: int, seed: int) -> None:
    terms = replace(DEVICE, T_exp_s=exposure_ms * 1e-3, T_store_s=store_ms * 1e-3, T_rand_s=0.0)
    base = delays(300, terms, Layout())
    store = base.store.copy()
    where = np.random.default_rng(seed).choice(250, len(stall_ms), replace=False)
    store[where] += np.array(stall_ms, np.int64) * 1_000_000
    period_s = line_period_s(terms, "stepped", Layout())
    needed = buffers_for_stall(latency_s(terms, "stepped"), period_s, longest_lateness_s(store, period_s))
    enough = replace(base, store=store, buffers=400, line_buffers=needed)
    assert mean_period_ns(earliest(enough, "stepped").starts) * 1e-9 == pytest.approx(period_s, abs=1e-12)


def test_the_sizing_rule_is_not_generous() -> None:
    period_s, latency = 31e-3, latency_s(replace(DEVICE, T_exp_s=0.02), "stepped")
    base = delays(300, replace(DEVICE, T_exp_s=0.02, T_rand_s=0.0), Layout())
    store = base.store.copy()
    store[100] += 400_000_000
    needed = buffers_for_stall(latency, period_s, longest_lateness_s(store, period_s))
    assert needed == 15
    lacking = replace(base, store=store, buffers=400, line_buffers=needed - 2)
    assert price_of_buffers(lacking, "stepped") > 1.0
    assert longest_lateness_s(np.zeros(0, np.int64), period_s) == 0


def test_no_such_mode() -> None:
    with pytest.raises(ValueError, match="mode must be one of sequential, stepped, continuous, not 'fly'"):
        circuits("fly", Layout())


@pytest.mark.parametrize(
    ("exposure_ms", "move_ms", "spread_ms", "overlap"),
    [(100, 10, 1.5, True), (100, 18, 9, False), (20, 18, 9, True), (10, 10, 5, True), (10, 10, 5, False)],
)
def test_random_moves_cost_the_mean_of_the_maximum(
    exposure_ms: float, move_ms: float, spread_ms: float, overlap: bool
) -> None:
    """E max(A, R) of a normal A (Clark), not max(E A, R), which `predict` therefore does not show as the period."""
    n, readout_ms = 20_000, 20.2
    rng = np.random.default_rng(1)
    terms = Terms(T_exp_s=exposure_ms * 1e-3, T_rx_s=1e-3, T_rd_s=readout_ms * 1e-3)
    moves = np.rint(rng.normal(move_ms, spread_ms, n) * 1e6).astype(np.int64)
    drawn = replace(delays(n, terms, Layout(overlap)), actuate=moves)
    sensor_ms = readout_ms - exposure_ms if overlap else readout_ms
    z = (move_ms - sensor_ms) / spread_ms
    longest_ms = sensor_ms + spread_ms * norm.pdf(z) + (move_ms - sensor_ms) * norm.cdf(z)
    period_ms = mean_period_ns(earliest(drawn, "stepped").starts) * 1e-6
    assert period_ms == pytest.approx(exposure_ms + longest_ms, abs=4 * spread_ms / n**0.5)
