"""Look-ahead: a move sent early gains its latency, and every line that it smears is flagged, and none else."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from scanhsi import open_instrument
from scanhsi.clock import now_ns, run_virtual
from scanhsi.cube.reader import read_records
from scanhsi.cube.records import LineRecords
from scanhsi.cube.sink import DiscardSink
from scanhsi.devices import CameraSettings, Exposure, Motion, PixelFormat
from scanhsi.devices.errors import ConfigError, ProtocolError, ScanFailed, UnsupportedFeature
from scanhsi.engine import Course, Mode, ScanPlan, ScanReport, run_scan
from scanhsi.engine.lookahead import Latencies
from scanhsi.imager import default_plan
from scanhsi.instrument import load_instrument
from support.bench import Bench, BenchActuator, BenchCamera, MemorySink


def course(lines: int, look_ahead: float | None, exposure_ms: float = 20) -> Course:
    steps = np.arange(lines, dtype=np.int64)
    taken = CameraSettings(exposure_ms * 1e-3, 0.0, PixelFormat.MONO12)
    return Course(Mode.STEPPED, taken, steps, steps * 0.1, look_ahead=look_ahead)


def scan(bench: Bench, lines: int, look_ahead: float | None, sink: MemorySink | None = None) -> ScanReport:
    sink = sink or MemorySink()
    planned = course(lines, look_ahead, bench.exposure_ms)
    return run_virtual(run_scan(planned, BenchCamera(bench), BenchActuator(bench), sink))


def moved_during(bench: Bench) -> list[int]:
    """Lines that were exposed while the mirror moved, by the bench, which knows."""
    smeared = bench.moved_while_exposing()
    return [line for line, exposure in enumerate(bench.exposures) if exposure in smeared]


# --- how early -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("probability", [0.003, 0.01, 0.1, 0.3])
@pytest.mark.parametrize("shape", [0.7, 2.0])
def test_the_accepted_probability_is_kept_whatever_the_distribution(probability: float, shape: float) -> None:
    drawn = np.random.default_rng(7).gamma(shape, 1e6, 20_000).astype(np.int64)
    latencies = Latencies(probability)
    early = 0
    for latency in drawn.tolist():
        early += latency < latencies.lead_ns(0)
        latencies.add(latency)
    spread = 4 * np.sqrt(probability * len(drawn))
    assert early <= probability * len(drawn) + spread
    assert early >= 0.8 * probability * len(drawn) - spread  # and used


def test_before_enough_is_known_only_what_is_sure_is_led_by() -> None:
    latencies = Latencies(0.1)
    for number in range(8):
        assert latencies.lead_ns(5) == 5
        latencies.add(100 + number)
    latencies.add(90)
    assert latencies.lead_ns(5) == 90  # the shortest of 9, with the tenth of equal chance


def test_latencies_that_change_are_followed() -> None:
    latencies = Latencies(0.01)
    for latency in [2_000] * 5000 + [9_000] * 1000:
        latencies.add(latency)
    assert latencies.lead_ns(0) == 9_000


# --- what is flagged -------------------------------------------------------------------------------------------------------

LATENCIES_MS = st.lists(st.floats(0, 6), min_size=1, max_size=7).map(tuple)


@settings(max_examples=60, deadline=None)
@given(latency_ms=LATENCIES_MS, exposure_ms=st.sampled_from([1.0, 9.0, 20.0]), readout_ms=st.sampled_from([0.0, 8.0]))
def test_without_look_ahead_the_mirror_never_moves_in_an_exposure(
    latency_ms: tuple[float, ...], exposure_ms: float, readout_ms: float
) -> None:
    bench = Bench(latency_ms=latency_ms, exposure_ms=exposure_ms, readout_ms=readout_ms, move_ms=6)
    report = scan(bench, 25, None)
    assert moved_during(bench) == []
    assert (report.smeared, report.look_ahead) == (0, None)


@settings(max_examples=120, deadline=None)
@given(
    latency_ms=LATENCIES_MS,
    exposure_ms=st.sampled_from([1.0, 9.0, 20.0]),
    transfer_ms=st.sampled_from([0.1, 5.0, 18.0]),
    probability=st.sampled_from([0.0, 0.05, 0.2, 0.5]),
)
def test_every_smeared_line_is_flagged_and_none_else(
    latency_ms: tuple[float, ...], exposure_ms: float, transfer_ms: float, probability: float
) -> None:
    """To the nanosecond, in virtual time, against what the bench saw; and the bound stays a bound."""
    bench = Bench(latency_ms=latency_ms, exposure_ms=exposure_ms, transfer_ms=transfer_ms, move_ms=6, readout_ms=0)
    sink = MemorySink()
    report = scan(bench, 40, probability, sink)
    assert np.flatnonzero(sink.records.smeared).tolist() == moved_during(bench)
    assert report.smeared == len(moved_during(bench))
    assert report.stored == 40
    assert probability or not report.smeared
    assert report.regret is not None
    assert report.regret >= 1 - 1e-12


def test_constant_latency_is_gained_whole_and_smears_nothing() -> None:
    """Motion begins as the exposure ends; the ordinary bound of stepped scans is beaten, that of look-ahead is reached."""
    plain = scan(Bench(move_ms=6, latency_ms=(2.5,)), 30, None)
    bench = Bench(move_ms=6, latency_ms=(2.5,), least_latency_ms=2.5)
    ahead = scan(bench, 30, 0.0)
    assert moved_during(bench) == []
    assert plain.period_s - ahead.period_s == pytest.approx(2.5e-3, abs=1e-9)
    assert ahead.regret == pytest.approx(1, abs=1e-9)


def test_a_flag_is_in_the_cube_even_where_the_frame_is_faster_than_the_move(tmp_path: Path) -> None:
    """A shard is written as soon as its lines are there: what becomes of the last one has to be known by then."""
    config = load_instrument(
        "sensors2019",
        {
            "camera.scene": "dark",
            "camera.profile": "ideal",
            "roi.bands": 8,
            "roi.samples": 16,
            "storage.lines_per_shard": 1,
        },
    )

    async def main() -> tuple[ScanReport, list[int]]:
        async with open_instrument(config) as imager:
            begun = watched(imager.actuator)
            plan = default_plan(config, lines=30, exposure="10 ms", mode="stepped", look_ahead=0.2)
            report = await imager.scan(plan, tmp_path / "cube.zarr")
            return report, begun[-29:]

    report, begun = run_virtual(main())
    records = read_records(tmp_path / "cube.zarr")
    truth = np.asarray(begun) < records.stamps["exposure_end"][:-1]
    assert records.smeared.tolist() == [*truth.tolist(), 0]
    assert 0 < report.smeared == int(truth.sum())


# --- the simulated instrument ----------------------------------------------------------------------------------------------


class KeepingSink(DiscardSink):
    """Discards lines and keeps their records."""

    async def open(self, records: LineRecords) -> None:
        self.records = records
        await super().open(records)


def watched(actuator: object) -> list[int]:
    """Begins of all motions from now on, as the simulated mirror knows them."""
    begun: list[int] = []
    mirror = actuator._bench.mirror  # type: ignore[attr-defined]  # the truth, which no driver tells
    turn: Callable[[int, int, int], None] = mirror.move

    def move(start_ns: int, end_ns: int, step: int) -> None:
        begun.append(start_ns)
        turn(start_ns, end_ns, step)

    mirror.move = move
    return begun


def simulated(look_ahead: float | None, exposure: str, lines: int = 1500) -> tuple[ScanReport, NDArray[np.bool_]]:
    """Report of a scan in virtual time; whether each line was truly smeared. Delays are the same whatever is asked."""
    config = load_instrument("sensors2019", {"camera.scene": "dark"}).with_seed(5)
    sink = KeepingSink()

    async def main() -> tuple[ScanReport, list[int]]:
        async with open_instrument(config) as imager:
            begun = watched(imager.actuator)
            plan = default_plan(config, lines=lines, exposure=exposure, mode="stepped", step=1, pixel_format="Mono8")
            planned = imager.course(plan.model_copy(update={"look_ahead": look_ahead}))
            return await run_scan(planned, imager.camera, imager.actuator, sink), begun

    report, begun = run_virtual(main())
    truth = np.asarray(begun[-(lines - 1) :]) < sink.records.stamps["exposure_end"][:-1]
    np.testing.assert_array_equal(sink.records.smeared[:-1].astype(bool), truth)
    return report, truth


@pytest.mark.parametrize("exposure", ["20 ms", "100 ms"])
def test_what_it_gains_and_costs_on_the_simulated_instrument(exposure: str) -> None:
    plain, never = simulated(None, exposure)
    assert not never.any()
    gained = []
    for accepted in (0.0, 0.003, 0.01, 0.1):
        ahead, smeared = simulated(accepted, exposure)
        assert smeared.sum() <= accepted * len(smeared) + 4 * np.sqrt(accepted * len(smeared))
        assert ahead.regret is not None
        assert 1 <= ahead.regret < 1.05
        gained.append((plain.period_s - ahead.period_s) * 1e3)
    assert gained == sorted(gained)
    assert gained[0] == pytest.approx(1.7, abs=1e-3)  # what the wire takes is sure
    assert gained[-1] < 2.5  # the mean of T_cmd: more cannot be had


# --- refused, failed, stopped ----------------------------------------------------------------------------------------------


def test_devices_that_cannot_are_refused_with_the_reason() -> None:
    class Mute(BenchActuator):
        least_latency_s = None  # type: ignore[assignment]

    class Blind(BenchCamera):
        expose_foretold = None  # type: ignore[assignment]

    bench = Bench()
    with pytest.raises(UnsupportedFeature, match="look-ahead needs the ability TellsStart"):
        run_virtual(run_scan(course(5, 0.01), BenchCamera(bench), Mute(bench), MemorySink()))
    with pytest.raises(UnsupportedFeature, match="look-ahead needs the ability ForetellsEnd"):
        run_virtual(run_scan(course(5, 0.01), Blind(bench), BenchActuator(bench), MemorySink()))
    assert bench.motions == []


def test_other_modes_refuse_it() -> None:
    with pytest.raises(ValueError, match="look_ahead is for stepped scans only, not for mode continuous"):
        ScanPlan(lines=3, exposure_s=0.1, mode=Mode.CONTINUOUS, look_ahead=0.01)
    sweep = replace(course(5, 0.01), mode=Mode.CONTINUOUS)
    with pytest.raises(UnsupportedFeature, match="look-ahead is for stepped scans, not for mode 'continuous'"):
        run_virtual(run_scan(sweep, BenchCamera(Bench()), BenchActuator(Bench()), MemorySink()))
    with pytest.raises(ConfigError, match="look_ahead"):
        default_plan(load_instrument("sensors2019"), look_ahead=0.9)


def test_drivers_that_promise_and_do_not_keep_it_fail_the_scan() -> None:
    class Forgetful(BenchActuator):
        async def move_to(self, step: int) -> Motion:
            motion = await super().move_to(step)
            return Motion(motion.step, motion.commanded_ns, motion.moved_ns)

    class Silent(BenchCamera):
        async def expose_foretold(self, foretold: Callable[[int], None]) -> Exposure:
            return await super().expose_foretold(lambda _: None)

    for camera, actuator, said in (
        (BenchCamera, Forgetful, "did not tell when the motion began"),
        (Silent, BenchActuator, "did not tell the end of the exposure"),
    ):
        bench = Bench()
        with pytest.raises(ScanFailed) as failed:
            run_virtual(run_scan(course(5, 0.01), camera(bench), actuator(bench), MemorySink()))
        assert isinstance(failed.value.causes[0], ProtocolError)
        assert said in str(failed.value)
        assert bench.stopped


@pytest.mark.parametrize("at_ms", [25, 38, 40.5, 43, 47])
def test_a_stop_request_finishes_the_line_and_sends_no_further_move(at_ms: float) -> None:
    """In an exposure before and after the next move was sent, and in the move."""
    bench, sink, stop = Bench(move_ms=6, latency_ms=(2.0,), least_latency_ms=2.0), MemorySink(), asyncio.Event()

    async def main() -> tuple[ScanReport, int]:
        asyncio.get_running_loop().call_later(at_ms * 1e-3, stop.set)
        report = await run_scan(course(50, 0.0), BenchCamera(bench), BenchActuator(bench), sink, stop=stop)
        return report, now_ns()

    report, ended_ns = run_virtual(main())
    assert report.stopped_early
    assert report.stored == len(bench.exposures)
    assert all(end <= ended_ns for _, end in bench.motions)
    assert moved_during(bench) == []
    assert bench.stopped
