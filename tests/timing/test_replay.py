"""Recorded delays replayed in blocks of lines."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import scanhsi
from scanhsi import clock
from scanhsi.cube import DiscardSink
from scanhsi.devices import PixelFormat
from scanhsi.devices.errors import ConfigError
from scanhsi.instrument import load_instrument
from scanhsi.instrument.timing import timing_of
from scanhsi.timing.bounds import LineDelays, earliest_starts, mean_period_ns
from scanhsi.timing.delays import DelayStreams
from scanhsi.timing.drops import lost
from scanhsi.timing.recording import dependence, profile_of
from scanhsi.timing.replay import ReplayedStreams, delay_streams
from support.recorded import MS, Ns, bursty_store, recorded, stamped, storing

RAMP = np.arange(1000, dtype=np.int64)


def test_blocks_are_lines_that_followed_each_other_and_never_cross_scans() -> None:
    profile = recorded({"T_act": RAMP[:300]}, {"T_act": RAMP[:700] + 10_000})
    drawn = delay_streams(profile, 7).array_ns("T_act", 20_000)
    follows = np.diff(drawn) == 1
    assert 1 / (1 - follows.mean()) == pytest.approx(44, rel=0.15)  # 50, less for those that wrap round
    jumps = drawn[1:][~follows]
    assert np.mean(jumps >= 10_000) == pytest.approx(0.7, abs=0.08)  # each line is as likely
    wraps = np.flatnonzero(drawn[:-1] == 299)
    assert len(wraps)
    assert np.mean(drawn[wraps + 1] == 0) > 0.8


def test_streams_of_a_line_stay_together_whatever_the_format_or_the_order_of_calls() -> None:
    act = np.random.default_rng(1).integers(0, MS, 400)
    profile = recorded({"T_act": act, "T_mcpy": 2 * act, "T_store": 3 * act})
    one, other = delay_streams(profile, 3), delay_streams(profile, 3)
    lines = list(range(0, 5000, 37))
    moves = [one.delay_ns("T_act", line, pixel_format="Mono8") for line in lines]
    assert [other.delay_ns("T_store", line, pixel_format="Mono8") for line in reversed(lines)] == [
        3 * move for move in reversed(moves)
    ]
    np.testing.assert_array_equal(
        other.array_ns("T_mcpy", 5000, pixel_format="Mono8"), 2 * one.array_ns("T_act", 5000, pixel_format="Mono8")
    )
    assert delay_streams(profile, 4).array_ns("T_act", 100).tolist() != one.array_ns("T_act", 100).tolist()


def test_each_pixel_format_has_its_own_lines() -> None:
    eight = stamped({"T_act": RAMP[:50], "T_rx": RAMP[:50]})
    twelve = stamped({"T_act": RAMP[:50] + 500, "T_rx": RAMP[:50] + 500}, pixel_format="Mono12")
    profile = profile_of([eight, twelve], name="two", source="a test", mark="measured")
    streams = delay_streams(profile, 1)
    for stream in ("T_act", "T_rx"):
        assert streams.array_ns(stream, 3000, pixel_format="Mono8").max() < 50
        assert streams.array_ns(stream, 3000, pixel_format="Mono12").min() >= 500
    with pytest.raises(ConfigError, match="no delay for Mono16"):
        streams.delay_ns("T_rx", 0, pixel_format="Mono16")


def test_a_line_without_a_delay_takes_that_of_the_line_before() -> None:
    profile = recorded({"T_act": np.array([-1, 10, -1, 30]), "T_mcpy": np.array([1, 2, 3, 4])})
    streams = delay_streams(profile, 1)
    copies, moves = (streams.array_ns(stream, 500, pixel_format="Mono8").tolist() for stream in ("T_mcpy", "T_act"))
    assert set(zip(copies, moves, strict=True)) == {(1, 10), (2, 10), (3, 10), (4, 30)}


def test_a_scan_that_lacks_a_stream_takes_it_from_the_others() -> None:
    """A sweep has no moves: its lines are replayed with the moves of the stepped scan, drawn one by one."""
    moved = stamped({"T_act": np.full(100, 70), "T_mcpy": np.full(100, 1)})
    swept = stamped({"T_mcpy": np.full(300, 2)}, mode="continuous")
    profile = profile_of([moved, swept], name="both", source="a test", mark="measured")
    streams = delay_streams(profile, 1)
    assert set(streams.array_ns("T_act", 2000, pixel_format="Mono8").tolist()) == {70}
    assert set(streams.array_ns("T_mcpy", 2000, pixel_format="Mono8").tolist()) == {1, 2}


def test_longer_moves_than_recorded_take_longer() -> None:
    rest = np.random.default_rng(2).integers(1000, 1100, 200)
    scans = [stamped({"T_act": rest + 500 * steps}, steps=steps) for steps in (1, 5)]
    profile = profile_of(scans, name="steps", source="a test", mark="measured")
    drawn = delay_streams(profile, 1).array_ns("T_act", 3000, steps=-9)
    assert set(drawn.tolist()) <= set((rest + 4500).tolist())


def test_each_line_or_each_delay_by_itself_where_asked() -> None:
    act = bursty_store(4000, 1)
    profile = recorded({"T_act": act, "T_mcpy": act})
    whole, lines, delays = (delay_streams(profile, 1, block_lines) for block_lines in (50, 1, 0))
    assert isinstance(whole, ReplayedStreams)
    assert type(delays) is DelayStreams
    first, second = (lines.array_ns(stream, 4000, pixel_format="Mono8") for stream in ("T_act", "T_mcpy"))
    np.testing.assert_array_equal(first, second)
    first, second = (delays.array_ns(stream, 4000, pixel_format="Mono8") for stream in ("T_act", "T_mcpy"))
    assert abs(np.corrcoef(first, second)[0, 1]) < 0.1
    following = [dependence([each.array_ns("T_act", 4000)]).acf[1] for each in (whole, lines)]
    assert following[0] == pytest.approx(dependence([act]).acf[1], abs=0.05)
    assert abs(following[1]) < 0.05


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_only_blocks_lose_the_lines_that_a_bursty_writer_loses(seed: int) -> None:
    """Sweep of 20.5 ms a line, 4 line buffers. Resampled line by line, drops come out ten times and more too few; with blocks of 50
    lines they are right within half (a recording of 8000 lines has some 27 bursts)."""

    def part_lost(store: Ns) -> float:
        return float(lost(storing(store, 4), 20_500_000).mean())

    measured = bursty_store(8000, seed)
    profile = recorded({"T_store": measured})
    truth = part_lost(measured)
    assert 0.01 < truth < 0.03
    blocks, lines, delays = (
        part_lost(delay_streams(profile, 9, block_lines).array_ns("T_store", 40_000)) for block_lines in (50, 1, 0)
    )
    assert blocks == pytest.approx(truth, rel=0.5)
    assert max(lines, delays) < truth / 10


@pytest.fixture(scope="module")
def bursty(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recorded profile with a bursty writer."""
    lines = 3000
    generator = np.random.default_rng(5)
    transfer, copy = generator.integers(9 * MS, 10 * MS, lines), generator.integers(MS, 2 * MS, lines)
    move = np.full(lines, 8 * MS)
    profile = recorded({"T_act": move, "T_rx": transfer, "T_mcpy": copy, "T_store": bursty_store(lines, 3)})
    path = tmp_path_factory.mktemp("profile") / "bursty.json"
    path.write_text(profile.model_dump_json(by_alias=True, exclude_none=True))
    return path


def replayed(path: Path, mode: str, block_lines: int = 50, **plan: str) -> tuple[scanhsi.ScanReport, LineDelays]:
    """The paper's instrument with these delays, in virtual time; and the delays that it should have met."""
    settings = {f"{role}.block_lines": block_lines for role in ("camera", "actuator")}
    config = load_instrument("sensors2019", settings).with_seed(4)

    async def main() -> scanhsi.ScanReport:
        async with scanhsi.open_instrument(config, delays=path) as hsi:
            course = hsi.default_plan(mode=mode, lines=1500, step=1, exposure="10 ms", pixel_format="Mono8", **plan)
            return await hsi.scan(course, None)

    met = timing_of(config.with_delays(str(path))).delays(1500, 0.01, PixelFormat.MONO8, 1)
    return clock.run(main(), virtual=True), replace(met, line_buffers=DiscardSink().capacity)


def test_a_sweep_loses_lines_to_the_replayed_writer(bursty: Path) -> None:
    """Exactly those of the model; and by far fewer where each line is drawn by itself."""
    report, met = replayed(bursty, "continuous", period="20.5 ms")
    gone = np.flatnonzero(lost(met, 20_500_000)).tolist()
    assert len(gone) > 5
    assert list(report.missing_reasons) == gone
    assert {reason.split(":")[0] for reason in report.missing_reasons.values()} == {"no free line buffer"}
    by_line, _ = replayed(bursty, "continuous", 1, period="20.5 ms")
    assert by_line.missing < len(gone) / 4


def test_a_stepped_scan_waits_for_the_replayed_writer(bursty: Path) -> None:
    """And takes as long as the bound of the same delays, to half a thousandth."""
    report, met = replayed(bursty, "stepped")
    assert report.missing == 0
    assert report.period_s * 1e9 == pytest.approx(mean_period_ns(earliest_starts(met, "stepped")), rel=5e-4)
    assert report.period_s > 1.01 * mean_period_ns(earliest_starts(replace(met, line_buffers=None), "stepped")) * 1e-9


def test_a_sequential_scan_pays_for_storing(bursty: Path) -> None:
    report, met = replayed(bursty, "sequential")
    assert report.period_s * 1e9 == pytest.approx(mean_period_ns(earliest_starts(met, "sequential")), rel=5e-4)


def test_a_real_instrument_is_refused(bursty: Path) -> None:
    with pytest.raises(ConfigError, match="cannot replay delays") as refused:
        load_instrument("twin", {"actuator.port": "p", "camera.address": "127.0.0.1"}).with_delays(str(bursty))
    assert len(refused.value.problems) == 2
    assert "not simulated" in refused.value.problems[0]
