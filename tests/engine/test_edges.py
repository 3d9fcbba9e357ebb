"""The edges of the engine: one line, slow lines, lost first lines, stops at odd moments, drivers that do not answer."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from scanhsi.clock import run_virtual
from scanhsi.devices import CameraSettings, FrameGap, Motion, PixelFormat, Sweep, Trigger
from scanhsi.devices.errors import DeviceLost, DeviceTimeout, MotionFailed, ScanFailed
from scanhsi.engine import Course, Mode, Progress, ScanReport, run_scan
from support.bench import Bench, BenchActuator, BenchCamera, MemorySink


def course(mode: Mode, *, lines: int = 12, first: int = 10, stride: int = 1, period_s: float | None = None) -> Course:
    steps = first + stride * np.arange(lines, dtype=np.int64)
    return Course(mode, CameraSettings(0.02, 0.0, PixelFormat.MONO12), steps, steps * 0.1, period_s)


def scan(wanted: Course, bench: Bench, sink: MemorySink | None = None, **kwargs: Any) -> ScanReport:
    async def main() -> ScanReport:
        return await run_scan(wanted, BenchCamera(bench), BenchActuator(bench), sink or MemorySink(), **kwargs)

    return run_virtual(main())


def scan_and_stop(wanted: Course, bench: Bench, sink: MemorySink, after_s: float) -> ScanReport:
    async def main() -> ScanReport:
        stop = asyncio.Event()
        asyncio.get_running_loop().call_later(after_s, stop.set)
        return await run_scan(wanted, BenchCamera(bench), BenchActuator(bench), sink, stop=stop)

    return run_virtual(main())


class RunningFree(BenchCamera):
    """A camera without a trigger input."""

    shortest_trigger_period_s = None

    def __init__(self, bench: Bench) -> None:
        super().__init__(bench)
        self.info = replace(self.info, triggers=frozenset({Trigger.SOFTWARE, Trigger.FREE_RUN}))


@pytest.mark.parametrize("mode", Mode)
@pytest.mark.parametrize("stride", [1, -1])
def test_one_line(mode: Mode, stride: int) -> None:
    sink = MemorySink()
    report = scan(course(mode, lines=1, stride=stride), Bench(), sink)
    assert (report.stored, report.regret) == (1, None)
    assert np.all(sink.pixels[0] == 10)


@pytest.mark.parametrize("lines", [1, 4])
def test_lines_may_be_further_apart_than_any_deadline(lines: int) -> None:
    report = scan(course(Mode.CONTINUOUS, lines=lines, period_s=60.0), Bench())
    assert report.stored == lines


def test_every_other_pulse_ignored_shifts_no_line() -> None:
    bench, sink = Bench(ignore=frozenset(range(1, 40, 2))), MemorySink()
    report = scan(course(Mode.CONTINUOUS, lines=40), bench, sink)
    assert sorted(report.missing_reasons) == list(range(1, 40, 2))
    for line in range(0, 40, 2):
        assert np.all(sink.pixels[line] == 10 + line)


def test_a_sweep_is_timed_from_its_first_line_also_when_that_is_lost() -> None:
    whole = scan(course(Mode.CONTINUOUS), Bench())
    without_first = scan(course(Mode.CONTINUOUS), Bench(lose=frozenset({0})))
    assert without_first.missing == 1
    assert without_first.duration_s == pytest.approx(whole.duration_s)


def test_progress_counts_each_line_once_and_lost_lines_do_not_raise_the_efficiency() -> None:
    told: list[Progress] = []
    scan(course(Mode.CONTINUOUS, lines=60), Bench(lose=frozenset(range(0, 60, 2))), on_progress=told.append)
    assert all(state.taken + state.missing <= 60 for state in told)
    assert (told[-1].taken, told[-1].missing, told[-1].remaining_s) == (30, 30, 0)
    assert told[-1].efficiency == pytest.approx(0.5, rel=0.1)


@pytest.mark.parametrize("mode", Mode)
@pytest.mark.parametrize("after_s", [0.0, 0.0021, 0.006, 0.012, 0.0159, 0.02, 0.04, 10.0])
def test_stop_at_any_moment_ends_in_a_true_report(mode: Mode, after_s: float) -> None:
    bench, sink = Bench(), MemorySink()
    report = scan_and_stop(course(mode), bench, sink, after_s)
    assert 0 <= report.duration_s < 1
    assert report.stopped_early == (report.stored < 12)
    assert np.count_nonzero(sink.records.status) == report.stored
    assert (bench.stopped, bench.armed, sink.closed) == (True, False, True)


@pytest.mark.parametrize("mode", Mode)
@pytest.mark.parametrize("after_s", [0.0005, 0.3])
def test_stop_while_homing_takes_no_line_and_moves_no_further(mode: Mode, after_s: float) -> None:
    bench, sink = Bench(homed=False), MemorySink()
    report = scan_and_stop(course(mode), bench, sink, after_s)
    assert (report.stored, report.missing, report.duration_s, report.stopped_early) == (0, 0, 0, True)
    assert (bench.exposures, bench.motions, bench.homed) == ([], [], False)
    assert (bench.stopped, bench.armed, sink.closed) == (True, False, True)


class Liar(BenchActuator):
    """Ends its first motion somewhere else, and says so."""

    async def move_to(self, step: int) -> Motion:
        return replace(await super().move_to(step), step=step + 3)


def test_the_first_line_is_not_taken_at_the_wrong_step_either() -> None:
    bench = Bench()

    async def main() -> None:
        await run_scan(course(Mode.STEPPED), BenchCamera(bench), Liar(bench), MemorySink())

    with pytest.raises(ScanFailed, match="line 0.*stands at step 13, not at 10") as failed:
        run_virtual(main())
    assert isinstance(failed.value.causes[0], MotionFailed)
    assert bench.exposures == []


def _hangs_first(method: Callable[..., Awaitable[Any]]) -> Callable[..., Awaitable[Any]]:
    calls: list[object] = []

    async def hanging(*args: Any) -> Any:
        calls.append(args)
        return await (asyncio.Event().wait() if len(calls) == 1 else method(*args))

    return hanging


@pytest.mark.parametrize(("device", "method"), [(BenchActuator, "stop"), (BenchCamera, "disarm")])
def test_a_stopped_sweep_does_not_hang(device: type, method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(device, method, _hangs_first(getattr(device, method)))
    sink = MemorySink()
    with pytest.raises(ScanFailed, match=method) as failed:
        scan_and_stop(course(Mode.CONTINUOUS), Bench(), sink, 0.1)
    assert isinstance(failed.value.causes[0], DeviceTimeout)
    assert sink.closed


def test_a_mirror_that_does_not_tell_where_it_is_holds_no_scan_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(BenchActuator, "locate", _hangs_first(BenchActuator.locate))
    with pytest.raises(ScanFailed, match="locate") as failed:
        scan(course(Mode.CONTINUOUS), Bench(ignore=frozenset({4})))
    assert isinstance(failed.value.causes[0], DeviceTimeout)


def test_a_gap_before_the_first_frame_of_a_free_running_camera_costs_no_line() -> None:
    """Its exposures begin before the mirror passes the first line: those have no line to lose."""

    class LosesTheFirst(RunningFree):
        async def arm(self, trigger: Trigger, buffers: int) -> None:
            await super().arm(trigger, buffers)
            self._index = 3
            self._channel.put(FrameGap(0, 3, "lost at the start"))

    class LateSweep(BenchActuator):
        """Its run-up takes five line periods more."""

        def run_up_s(self, sweep: Sweep) -> float:
            return super().run_up_s(sweep) + 0.1

        async def sweep(self, sweep: Sweep) -> Motion:
            await asyncio.sleep(0.1)
            return await super().sweep(sweep)

    bench, sink = Bench(), MemorySink()

    async def main() -> ScanReport:
        return await run_scan(course(Mode.CONTINUOUS), LosesTheFirst(bench), LateSweep(bench), sink)

    assert run_virtual(main()).missing_reasons == {}


class WholeRates(BenchActuator):
    """Knows whole steps/s only, as the stepper's firmware."""

    def check_sweep(self, sweep: Sweep) -> Sweep:
        return replace(super().check_sweep(sweep), rate_steps_s=float(int(sweep.rate_steps_s)))


@pytest.mark.parametrize("camera", [BenchCamera, RunningFree])
def test_a_sweep_slower_than_asked_is_told_and_the_frame_clock_follows(
    camera: type[BenchCamera], caplog: pytest.LogCaptureFixture
) -> None:
    bench, sink = Bench(), MemorySink(capacity=100)

    async def main() -> ScanReport:
        wanted = course(Mode.CONTINUOUS, lines=60, period_s=0.3)  # 3.33 steps/s, of which 3 can be had
        return await run_scan(wanted, camera(bench), WholeRates(bench), sink)

    assert run_virtual(main()).period_s == pytest.approx(1 / 3)
    for line in range(1, 60):  # the first free-running exposure may begin a moment before the mirror is there
        assert int(sink.pixels[line][0, 0]) == pytest.approx(sink.records.mirror_step[line], abs=1)
    assert "slower than asked" in caplog.text


def test_a_mirror_that_does_not_stop_is_told_of_also_when_the_scan_is_cancelled(
    caplog: pytest.LogCaptureFixture,
) -> None:
    class Stuck(BenchActuator):
        async def stop(self) -> None:
            raise DeviceLost("it does not answer its stop.", device="actuator bench")

    async def main() -> None:
        bench = Bench()
        task = asyncio.ensure_future(run_scan(course(Mode.STEPPED), BenchCamera(bench), Stuck(bench), MemorySink()))
        await asyncio.sleep(0.1)
        task.cancel()
        await task

    with pytest.raises(asyncio.CancelledError):
        run_virtual(main())
    assert "does not answer its stop" in caplog.text
