"""The recursion against the closed forms of the line period, and regret as a theorem."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scanhsi.timing.bounds import LineDelays, bound, earliest, earliest_starts, mean_period_ns
from scanhsi.timing.observed import delays_of, exposure_starts, stage_times

ABSENT = np.iinfo(np.int64).min
ms = st.integers(1, 200_000_000)


def constant(n: int, **ns: int) -> LineDelays:
    column = {
        name: np.full(n, ns.get(name, 0), np.int64)
        for name in ("exposure", "actuate", "trigger", "transfer", "copy", "store")
    }
    return LineDelays(
        **column,
        readout_ns=ns.get("readout", 0),
        dead_ns=ns.get("dead", 0),
        overlap=bool(ns.get("overlap", 1)),
        buffers=ns.get("buffers", 1000),
    )


@given(exposure=ms, actuate=ms, trigger=ms, transfer=ms, copy=ms, store=ms, readout=ms)
def test_closed_forms(
    exposure: int, actuate: int, trigger: int, transfer: int, copy: int, store: int, readout: int
) -> None:
    delays = {
        "exposure": exposure,
        "actuate": actuate,
        "trigger": trigger,
        "transfer": transfer,
        "copy": copy,
        "store": store,
        "readout": readout,
    }
    step = actuate + trigger
    expected = {
        ("sequential", 1): exposure + max(transfer + copy + store + step, readout - exposure, 0),
        ("stepped", 1): max(exposure + step, readout),
        ("stepped", 0): exposure + max(step, readout),
        ("continuous", 1): max(exposure, readout),
        ("continuous", 0): exposure + readout,
    }
    for (mode, overlap), period in expected.items():
        starts = earliest_starts(constant(50, **delays, overlap=overlap), mode)
        assert mean_period_ns(starts[1:]) == pytest.approx(period, abs=1), (mode, overlap)


@pytest.mark.parametrize(
    ("exposure", "mode", "period"),
    [  # timing reference values of the paper's device, 8 bit, in ms
        (100, "stepped", 111.0),
        (20, "stepped", 31.0),
        (10, "stepped", 21.0),
        (10, "continuous", 20.2),
        (100, "continuous", 100.0),
    ],
)
def test_table_of_the_papers_device(exposure: float, mode: str, period: float) -> None:
    delays = constant(
        200,
        exposure=int(exposure * 1e6),
        actuate=10_000_000,
        trigger=1_000_000,
        transfer=18_160_000,
        copy=500_000,
        store=2_500_000,
        readout=20_200_000,
    )
    assert mean_period_ns(earliest_starts(delays, mode)[3:]) * 1e-6 == pytest.approx(period, abs=1e-6)


@given(st.lists(st.tuples(ms, ms, ms), min_size=8, max_size=40), st.integers(0, 10_000_000))
def test_nothing_beats_the_bound(delays: list[tuple[int, int, int]], lateness: int) -> None:
    """Any schedule that respects the same delays has a regret of at least 1."""
    n = len(delays)
    exposure, actuate, transfer = (np.array(column, np.int64) for column in zip(*delays, strict=True))
    rng = np.random.default_rng(n)
    base = constant(n, readout=5_000_000)
    realised = LineDelays(exposure, actuate, base.trigger, transfer, base.copy, base.store, 5_000_000, 0, True, 8)
    late = rng.integers(0, lateness + 1, n)
    slowed = LineDelays(exposure, actuate + late, base.trigger, transfer, base.copy, base.store, 5_000_000, 0, True, 8)
    measured = earliest(slowed, "stepped")
    found = bound(measured.starts, measured.copied, realised, "stepped")
    assert found is not None
    assert found.regret >= 1.0


def test_stamps_give_back_the_delays_and_leave_out_what_the_engine_added() -> None:
    n = 5
    start = np.arange(n, dtype=np.int64) * 100
    stamps = {
        "commanded": start - 30,
        "moved": start - 10,
        "trigger": start - 4,
        "exposure_start": start,
        "exposure_end": start + 60,  # timed with a margin of 10
        "first_byte": start + 62,
        "received": start + 80,
        "copied": start + 85,
        "stored": start + 90,
    }
    starts, delays = delays_of(stamps, exposure_ns=50, readout_ns=7, dead_ns=0, overlap=True, buffers=16)
    assert starts.tolist() == start.tolist()
    assert [
        int(column[1]) for column in (delays.exposure, delays.actuate, delays.trigger, delays.transfer, delays.copy)
    ] == [
        50,
        20,
        4,
        18,
        5,
    ]
    times = stage_times(stamps)
    assert times["transfer"].mean_s == pytest.approx(20e-9)
    assert times["line"].p50_s == pytest.approx(100e-9)


def test_lines_without_stamps_are_left_out() -> None:
    column = np.array([0, ABSENT, 200], np.int64)
    stamps = dict.fromkeys(
        (
            "commanded",
            "moved",
            "trigger",
            "exposure_start",
            "exposure_end",
            "first_byte",
            "received",
            "copied",
            "stored",
        ),
        column,
    )
    starts, delays = delays_of(stamps, exposure_ns=50, readout_ns=0, dead_ns=0, overlap=True, buffers=16)
    assert starts.tolist() == [0, 200]
    assert len(delays.exposure) == 2
    assert exposure_starts(stamps).tolist() == [0, 200]


def test_no_bound_for_a_single_line_or_no_delays() -> None:
    one, five = np.zeros(1, np.int64), np.zeros(5, np.int64)
    assert bound(one, one, constant(1, exposure=5), "stepped") is None
    assert bound(five, five, constant(5), "stepped") is None
    assert bound(five, np.full(5, ABSENT), constant(5, exposure=5), "stepped") is None


def test_a_last_line_that_was_lost_does_not_count() -> None:
    """The scan is compared up to the last line that came."""
    delays = constant(10, exposure=20, actuate=5, transfer=10)
    schedule = earliest(delays, "stepped")
    delivered = np.where(np.arange(10) < 8, schedule.copied, ABSENT)
    found = bound(schedule.starts, delivered, delays, "stepped")
    assert found is not None
    assert found.regret == 1


def test_a_slow_link_sets_the_pace_through_the_buffers() -> None:
    delays = constant(400, exposure=20, actuate=5, transfer=40, buffers=4)
    assert mean_period_ns(earliest_starts(delays, "stepped")[10:]) == pytest.approx(40, abs=0.1)
    assert mean_period_ns(earliest_starts(delays, "continuous")[10:]) == pytest.approx(40, abs=0.1)


def test_a_sweep_ahead_of_the_buffers_is_not_said_to_beat_physics() -> None:
    """While the camera's own memory takes the frames, a slow link holds no exposure back."""
    count = 200
    nothing = np.zeros(count, np.int64)
    delays = LineDelays(
        exposure=np.full(count, 20_000_000),
        actuate=nothing,
        trigger=nothing,
        transfer=np.full(count, 29_000_000),
        copy=nothing,
        store=nothing,
        readout_ns=20_200_000,
        dead_ns=0,
        overlap=True,
        buffers=16,
    )
    few = replace(delays, buffers=1)
    starts = np.arange(count) * 20_200_000
    delivered = 20_000_000 + 29_000_000 * np.arange(1, count + 1)  # the link is never idle
    ahead = bound(starts, delivered, few, "continuous")
    assert ahead is not None
    assert ahead.regret == 1, "with one buffer the earliest schedule exposes and transfers in turn"
    kept_up = bound(starts, delivered, delays, "continuous")
    assert kept_up is not None
    assert (kept_up.regret, kept_up.period_s) == (1, pytest.approx(0.029))
