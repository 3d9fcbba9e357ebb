"""The three modes on the bench: exact periods, right pixels, reasons for what is missing."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scanhsi.clock import now_ns, run_virtual
from scanhsi.cube.records import LineStatus
from scanhsi.devices import CameraSettings, Exposure, PixelFormat, Trigger
from scanhsi.devices.errors import DeviceError, DeviceLost, OutOfRange, ScanFailed
from scanhsi.engine import Course, Mode, ScanReport, run_scan
from scanhsi.engine.scan import CAMERA_BUFFERS
from support.bench import Bench, BenchActuator, BenchCamera, MemorySink

LINES = 12


def course(mode: Mode, bench: Bench, *, lines: int = LINES, first: int = -6, stride: int = 1) -> Course:
    steps = first + stride * np.arange(lines, dtype=np.int64)
    taken = CameraSettings(bench.exposure_ms * 1e-3, 0.0, PixelFormat.MONO12)
    return Course(mode, taken, steps, steps * 0.1)


def scan(mode: Mode, bench: Bench, sink: MemorySink, **kwargs: int) -> ScanReport:
    async def main() -> ScanReport:
        return await run_scan(course(mode, bench, **kwargs), BenchCamera(bench), BenchActuator(bench), sink)

    return run_virtual(main())


@pytest.mark.parametrize(
    ("mode", "period_ms"),
    [
        (Mode.SEQUENTIAL, 20 + 5 + 1 + 3),  # exposure, transfer, copy, move
        (Mode.STEPPED, 20 + 3),  # transfer and copy hide behind motion and the next exposure
        (Mode.CONTINUOUS, 20),  # nothing but the exposure
    ],
)
def test_line_period_is_the_bound_of_the_mode(mode: Mode, period_ms: float) -> None:
    bench, sink = Bench(copy_ms=1.0), MemorySink()
    report = scan(mode, bench, sink)
    assert report.period_s == pytest.approx(period_ms * 1e-3, abs=1e-9)
    assert report.efficiency == pytest.approx(20 / period_ms)
    assert report.regret == pytest.approx(1.0, abs=1e-9)
    assert (report.stored, report.missing) == (LINES, 0)


@pytest.mark.parametrize("mode", Mode)
@pytest.mark.parametrize("stride", [1, 3, -2])
def test_each_line_holds_what_the_mirror_showed(mode: Mode, stride: int) -> None:
    bench, sink = Bench(), MemorySink(batch=5, capacity=10)
    scan(mode, bench, sink, first=20, stride=stride)
    for line in range(LINES):
        assert np.all(sink.pixels[line] == (20 + line * stride) % 256), line
        assert sink.records.mirror_step[line] == 20 + line * stride
    assert np.all(sink.records.status == LineStatus.STORED)
    assert bench.stopped
    assert not bench.armed
    assert sink.closed


def test_stamps_are_in_the_order_of_the_stages() -> None:
    bench, sink = Bench(copy_ms=1.0), MemorySink()
    scan(Mode.STEPPED, bench, sink)
    stages = [
        "commanded",
        "moved",
        "trigger",
        "exposure_start",
        "exposure_end",
        "first_byte",
        "received",
        "copied",
        "stored",
    ]
    columns = np.array([sink.records.stamps[stage][1:] for stage in stages])
    assert np.all(np.diff(columns, axis=0) >= 0)


@given(
    exposure_ms=st.floats(0.1, 50),
    transfer_ms=st.floats(0, 60),
    move_ms=st.floats(0.01, 30),
    copy_ms=st.floats(0, 20),
    store_ms=st.floats(0, 40),
    capacity=st.integers(1, 6),
    mode=st.sampled_from([Mode.SEQUENTIAL, Mode.STEPPED]),
)
@settings(max_examples=60, deadline=None)
def test_mirror_is_still_in_every_exposure(
    exposure_ms: float,
    transfer_ms: float,
    move_ms: float,
    copy_ms: float,
    store_ms: float,
    capacity: int,
    mode: Mode,
) -> None:
    bench = Bench(exposure_ms=exposure_ms, transfer_ms=transfer_ms, move_ms=move_ms, copy_ms=copy_ms)
    sink = MemorySink(capacity=capacity, store_ms=store_ms)
    report = scan(mode, bench, sink)
    assert bench.moved_while_exposing() == []
    assert len(bench.exposures) == report.stored == LINES
    assert sink.most_in_memory <= capacity


def test_a_move_during_exposure_would_be_caught() -> None:
    """The monitor has teeth: a camera whose ``expose`` returns 5 ms too early lets the mirror move in mid-exposure."""

    class Hasty(BenchCamera):
        async def expose(self) -> Exposure:
            start = now_ns()
            index = self._begin(start, start + 20_000_000)
            await asyncio.sleep(0.015)
            return Exposure(index=index, trigger_ns=start, start_ns=start, end_ns=start + 15_000_000, timed=False)

    bench = Bench()

    async def main() -> None:
        await run_scan(course(Mode.STEPPED, bench), Hasty(bench), BenchActuator(bench), MemorySink())

    run_virtual(main())
    assert len(bench.moved_while_exposing()) == LINES - 1


def test_slow_writer_holds_the_trigger_and_loses_nothing() -> None:
    bench, sink = Bench(), MemorySink(capacity=4, store_ms=100)
    report = scan(Mode.STEPPED, bench, sink, lines=40)
    assert report.stored == 40
    assert sink.most_in_memory == 4
    assert report.period_s == pytest.approx(0.100, rel=0.1)


def test_slow_unpacking_holds_the_trigger_before_the_cameras_buffers_run_out() -> None:
    bench, sink = Bench(copy_ms=100), MemorySink(capacity=100)
    report = scan(Mode.STEPPED, bench, sink, lines=60)
    assert report.stored == 60
    assert sink.most_in_memory <= CAMERA_BUFFERS + 1
    assert report.period_s == pytest.approx(0.100, rel=0.3)


def test_slow_writer_costs_a_sweep_lines_which_are_counted() -> None:
    bench, sink = Bench(), MemorySink(capacity=4, store_ms=50)
    report = scan(Mode.CONTINUOUS, bench, sink, lines=40)
    assert 0 < report.missing < 40
    assert report.stored + report.missing == 40
    assert all("no free line buffer" in reason for reason in report.missing_reasons.values())
    for line in np.flatnonzero(sink.records.status == LineStatus.STORED):
        assert np.all(sink.pixels[line] == (-6 + line) % 256)
    assert sink.most_in_memory <= 4


@pytest.mark.parametrize("mode", Mode)
def test_lost_frames_are_marked_missing_with_their_reason(mode: Mode) -> None:
    bench, sink = Bench(lose=frozenset({0, 3, 4, LINES - 1})), MemorySink()
    report = scan(mode, bench, sink, first=10)
    assert report.missing_reasons == dict.fromkeys((0, 3, 4, LINES - 1), "the bench lost it")
    assert np.flatnonzero(sink.records.status == LineStatus.MISSING).tolist() == [0, 3, 4, LINES - 1]
    for line in (1, 2, 5, 10):
        assert np.all(sink.pixels[line] == 10 + line)


@pytest.mark.parametrize("mode", [Mode.SEQUENTIAL, Mode.STEPPED])
def test_a_frame_swallowed_without_a_word_is_missed_by_its_deadline(mode: Mode) -> None:
    bench, sink = Bench(swallow=frozenset({4, LINES - 1})), MemorySink()
    report = scan(mode, bench, sink)
    assert list(report.missing_reasons) == [4, LINES - 1]
    assert "did not arrive within" in report.missing_reasons[LINES - 1]
    assert report.stored == LINES - 2
    assert np.all(sink.pixels[5] == (-6 + 5) % 256)


def test_a_silent_camera_ends_the_scan() -> None:
    bench, sink = Bench(swallow=frozenset(range(5, LINES))), MemorySink()
    with pytest.raises(ScanFailed, match="no frame came for 2 lines in a row") as failed:
        scan(Mode.STEPPED, bench, sink)
    assert isinstance(failed.value.causes[0], DeviceLost)
    assert failed.value.stored == 5
    assert bench.stopped
    assert not bench.armed
    assert sink.closed


@pytest.mark.parametrize("ignored", [0, 1, 5, LINES - 1])
def test_a_pulse_that_the_camera_ignored_shifts_no_line(ignored: int) -> None:
    bench, sink = Bench(ignore=frozenset({ignored})), MemorySink()
    report = scan(Mode.CONTINUOUS, bench, sink, first=10)
    assert list(report.missing_reasons) == [ignored]
    for line in set(range(LINES)) - {ignored}:
        assert np.all(sink.pixels[line] == 10 + line), line


@pytest.mark.parametrize("stall_ms", [17, 30, 100])
def test_a_mirror_that_falls_behind_loses_no_line(stall_ms: float) -> None:
    """A late frame alone proves nothing: the actuator is asked, and no line is taken for lost."""
    bench, sink = Bench(stalls={4: stall_ms, 9: stall_ms}), MemorySink()
    report = scan(Mode.CONTINUOUS, bench, sink, first=10)
    assert report.missing_reasons == {}
    for line in range(LINES):
        assert np.all(sink.pixels[line] == 10 + line), line


@pytest.mark.parametrize("lines", [1, 2, 5])
def test_a_short_sweep_that_begins_late_loses_no_line(lines: int) -> None:
    """It is over before its first frame is here, so the mirror cannot be asked any more: the exposures are counted."""
    bench, sink = Bench(stalls={0: 700}, transfer_ms=120), MemorySink()
    report = scan(Mode.CONTINUOUS, bench, sink, lines=lines, first=10)
    assert report.missing_reasons == {}
    for line in range(lines):
        assert np.all(sink.pixels[line] == 10 + line), line


@pytest.mark.parametrize("ignored", [{0}, {0, 1}, {2}])
def test_pulses_ignored_in_a_short_sweep_shift_no_line(ignored: set[int]) -> None:
    bench, sink = Bench(ignore=frozenset(ignored), transfer_ms=120), MemorySink()
    report = scan(Mode.CONTINUOUS, bench, sink, lines=4, first=10)
    assert set(report.missing_reasons) == ignored
    for line in set(range(4)) - ignored:
        assert np.all(sink.pixels[line] == 10 + line), line


def test_lost_pulses_and_a_mirror_that_falls_behind() -> None:
    bench, sink = Bench(stalls={4: 50}, ignore=frozenset({6, 7})), MemorySink()
    report = scan(Mode.CONTINUOUS, bench, sink, first=10)
    assert list(report.missing_reasons) == [6, 7]
    for line in set(range(LINES)) - {6, 7}:
        assert np.all(sink.pixels[line] == 10 + line), line


@pytest.mark.parametrize("exposure_ms", [20.0, 9.0])
@pytest.mark.parametrize("stride", [1, 4, -4])
@pytest.mark.parametrize("stalls", [{}, {0: 100.0}, {0: 333.0}, {4: 50.0}, {3: 30.0, 8: 40.0}], ids=str)
def test_free_running_camera_in_a_sweep(stalls: dict[int, float], stride: int, exposure_ms: float) -> None:
    """Also where the mirror begins late or falls behind: what was exposed before it got there is dropped."""
    bench, sink = Bench(stalls=stalls, exposure_ms=exposure_ms), MemorySink()

    class Unwired(BenchCamera):
        shortest_trigger_period_s = None  # no hardware trigger: the engine lets it run free

    async def main() -> ScanReport:
        camera = Unwired(bench)
        camera.info = replace(camera.info, triggers=frozenset({Trigger.SOFTWARE, Trigger.FREE_RUN}))
        wanted = course(Mode.CONTINUOUS, bench, first=60, stride=stride)
        return await run_scan(wanted, camera, BenchActuator(bench), sink)

    report = run_virtual(main())
    assert report.missing <= 1 + len(stalls), report.missing_reasons
    for line in set(range(1, LINES)) - report.missing_reasons.keys():  # this mirror jumps to the first
        seen = (int(sink.pixels[line][0, 0]) - 60) / stride  # in whole steps
        assert seen == pytest.approx(line, abs=1 + 1 / abs(stride)), line


def test_storage_that_fails_ends_the_scan_and_says_why() -> None:
    bench, sink = Bench(), MemorySink(fail_at_line=6)
    with pytest.raises(ScanFailed, match="6 of 12 lines stored in memory: OSError.*No space left"):
        scan(Mode.STEPPED, bench, sink)
    assert bench.stopped
    assert not bench.armed
    assert sink.closed


def test_what_is_not_allowed_is_refused_before_anything_moves() -> None:
    for wrong in (
        {"first": 4995},  # beyond the limits of the mirror
        {"first": -5001},
    ):
        bench, sink = Bench(), MemorySink()
        with pytest.raises(OutOfRange, match="allowed is -5000 to 5000 steps"):
            scan(Mode.STEPPED, bench, sink, **wrong)
        assert (bench.operations, sink.opened) == (0, False)
    bench, sink = Bench(exposure_ms=2001), MemorySink()
    with pytest.raises(OutOfRange, match="exposure 2.001 s is not allowed; allowed is 0 to 2 s"):
        scan(Mode.STEPPED, bench, sink)
    assert (bench.operations, sink.opened) == (0, False)


def test_an_actuator_that_is_not_homed_is_homed_first() -> None:
    bench, sink = Bench(homed=False), MemorySink()
    scan(Mode.STEPPED, bench, sink)
    assert bench.homed


def test_stop_finishes_the_line_and_closes() -> None:
    for mode in Mode:
        bench, sink = Bench(), MemorySink(batch=5, capacity=10)

        async def main(mode: Mode = mode, bench: Bench = bench, sink: MemorySink = sink) -> ScanReport:
            stop = asyncio.Event()
            task = asyncio.ensure_future(
                run_scan(course(mode, bench), BenchCamera(bench), BenchActuator(bench), sink, stop=stop)
            )
            await asyncio.sleep(0.130)
            stop.set()
            return await task

        report = run_virtual(main())
        assert report.stopped_early
        assert 2 <= report.stored < LINES
        assert sink.closed
        assert bench.stopped
        assert len(bench.exposures) == report.stored


def test_progress_is_told_and_ends_at_the_last_line() -> None:
    bench, told = Bench(), []

    async def main() -> None:
        await run_scan(
            course(Mode.STEPPED, bench, lines=100),
            BenchCamera(bench),
            BenchActuator(bench),
            MemorySink(),
            on_progress=told.append,
        )

    run_virtual(main())
    assert told[-1].taken == 100
    assert len(told) <= 2.3 / 0.25 + 3
    assert told[-1].efficiency == pytest.approx(20 / 23, rel=0.02)


def test_cleanup_failure_alone_fails_the_scan() -> None:
    bench = Bench()

    class Stuck(BenchActuator):
        async def stop(self) -> None:
            raise DeviceLost("it does not answer its stop.", device="actuator bench")

    async def main() -> None:
        await run_scan(course(Mode.STEPPED, bench), BenchCamera(bench), Stuck(bench), MemorySink())

    with pytest.raises(ScanFailed, match="12 of 12 lines stored.*does not answer its stop") as failed:
        run_virtual(main())
    assert all(isinstance(cause, DeviceError) for cause in failed.value.causes)
