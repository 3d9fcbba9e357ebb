"""Cancel a short scan before every callback, fail every device operation, and both: the guarantees hold each time."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest

from scanhsi.cube.records import LineStatus
from scanhsi.devices import CameraSettings, PixelFormat
from scanhsi.devices.errors import DeviceLost, ScanFailed
from scanhsi.engine import Course, Mode, OnFault, Recovery, ScanControl, control, run_scan
from scanhsi.engine.scan import Scan
from support.bench import Bench, BenchActuator, BenchCamera, MemorySink
from support.fuzz import Outcome, cancel_everywhere, run_with_cancel_before

LINES = 4
SKIP = Recovery()


@dataclass
class Case:
    """One scan with everything it touches, made anew for each run."""

    mode: Mode
    fail_at: int | None = None
    camera: Callable[[Bench], BenchCamera] = BenchCamera
    look_ahead: float | None = None
    latency_ms: tuple[float, ...] = (2.0,)
    recovery: Recovery = SKIP
    pause_ms: float | None = None

    def __post_init__(self) -> None:
        self.renew()

    def renew(self) -> None:
        self.bench = Bench(fail_at=self.fail_at, copy_ms=0.5)
        if self.look_ahead is not None:
            self.bench.latency_ms, self.bench.least_latency_ms = self.latency_ms, 2.0
        self.sink = MemorySink(batch=2, capacity=4, store_ms=2.0)

    async def scan(self) -> None:
        steps = np.arange(LINES, dtype=np.int64)
        course = Course(self.mode, CameraSettings(0.02, 0.0, PixelFormat.MONO12), steps, steps * 0.1)
        course = replace(course, look_ahead=self.look_ahead, recovery=self.recovery)
        control = ScanControl()
        if self.pause_ms is not None:
            loop = asyncio.get_running_loop()
            loop.call_later(self.pause_ms * 1e-3, control.pause)
            loop.call_later(self.pause_ms * 1e-3 + 0.1, control.go_on)
        await run_scan(course, self.camera(self.bench), BenchActuator(self.bench), self.sink, control=control)

    def main(self):
        self.renew()
        return self.scan()

    def moved_unflagged(self) -> list[int]:
        """Lines in which the mirror moved: any without look-ahead, with it those that were stored and not flagged as smeared."""
        bench, records = self.bench, self.sink.records
        moved = bench.moved_while_exposing()
        lines = [line for line, exposure in enumerate(bench.exposures) if exposure in moved]
        if self.look_ahead is None:
            return lines
        return [line for line in lines if records.status[line] and not records.smeared[line]]

    def violations(self, outcome: Outcome) -> list[str]:
        """What does not hold after a run."""
        bench, sink = self.bench, self.sink
        stored = np.flatnonzero(sink.records.status != LineStatus.NOT_STORED) if sink.records.lines else np.array([])
        found = {
            "a cancellation was swallowed": bool(outcome.requested) and not outcome.surfaced,
            "a task was left": bool(outcome.orphans),
            "an exception went to the loop": bool(outcome.unhandled),
            "the mirror was not stopped": not bench.stopped,
            "the camera is armed": bench.armed,
            "the sink was not closed": sink.opened and not sink.closed,
            "the mirror moved in an exposure": bool(self.moved_unflagged()),
            "a move goes on": bench.moving,
            "stored lines are not a prefix": stored.tolist() != list(range(len(stored))),
            "a stored line is wrong": any(np.any(sink.pixels[int(line)] != line) for line in stored),
            "the wrong exception": outcome.error is not None and not isinstance(outcome.error, ScanFailed | DeviceLost),
        }
        return [name for name, holds in found.items() if holds]


AHEAD = [
    pytest.param(0.0, (2.0,), id="sure"),
    pytest.param(0.5, (2.0, 3.0, 2.0), id="accepted"),
]


@pytest.mark.parametrize(("look_ahead", "latency_ms"), AHEAD)
def test_a_move_sent_ahead_is_never_left_behind(look_ahead: float, latency_ms: tuple[float, ...]) -> None:
    """Cancelled before every callback, and with every operation failing, and both: while an exposure and a move are under way."""
    case = Case(Mode.STEPPED, look_ahead=look_ahead, latency_ms=latency_ms)
    cases = 0
    for outcome in cancel_everywhere(case.main, again_after=(None, 1, 2, 5, 20)):
        assert not case.violations(outcome), (outcome, case.violations(outcome))
        cases += 1
    assert cases > 250
    run_with_cancel_before(case.main, None)
    for number in range(case.bench.operations):
        failing = Case(Mode.STEPPED, fail_at=number, look_ahead=look_ahead, latency_ms=latency_ms)
        outcome = run_with_cancel_before(failing.main, None)
        assert isinstance(outcome.error, ScanFailed | DeviceLost), number
        assert "pulled the plug" in str(outcome.error)
        assert not failing.violations(outcome), (number, failing.violations(outcome))
        for both in cancel_everywhere(failing.main) if number in (4, 6, 8, 10, 12) else ():
            assert not failing.violations(both), (number, both, failing.violations(both))


def test_a_move_left_behind_would_be_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    """An engine that only starts the move, and does not hold on to it, leaves it going on, and its task."""

    async def loose(scan: Scan, line: int) -> None:
        foretold: asyncio.Future[int] = asyncio.get_running_loop().create_future()
        moving = asyncio.ensure_future(control._move_ahead(scan, line + 1, foretold))
        await control._expose(scan, line, foretold.set_result)
        await moving

    monkeypatch.setattr(control, "_expose_and_move_on", loose)
    case = Case(Mode.STEPPED, look_ahead=0.0)
    broken = {name for outcome in cancel_everywhere(case.main) for name in case.violations(outcome)}
    assert {"a task was left", "a move goes on"} & broken


@pytest.mark.parametrize("mode", Mode)
def test_cancel_before_every_callback(mode: Mode) -> None:
    case = Case(mode)
    cases = 0
    for outcome in cancel_everywhere(case.main, again_after=(None, 1, 2, 5, 20)):
        assert not case.violations(outcome), (outcome, case.violations(outcome))
        cases += 1
    assert cases > 250


@pytest.mark.parametrize("mode", Mode)
def test_every_device_operation_fails(mode: Mode) -> None:
    healthy = Case(mode)
    run_with_cancel_before(healthy.main, None)
    assert healthy.bench.operations > 3 * LINES if mode is not Mode.CONTINUOUS else LINES
    for number in range(healthy.bench.operations):
        case = Case(mode, fail_at=number)
        outcome = run_with_cancel_before(case.main, None)
        assert isinstance(outcome.error, ScanFailed | DeviceLost), number
        assert "pulled the plug" in str(outcome.error)
        assert not case.violations(outcome), (number, case.violations(outcome))


@pytest.mark.parametrize("mode", Mode)
def test_failure_and_cancellation_together(mode: Mode) -> None:
    for number in (1, 4, 7, 10):
        case = Case(mode, fail_at=number)
        for outcome in cancel_everywhere(case.main):
            assert not case.violations(outcome), (number, outcome, case.violations(outcome))


@pytest.mark.parametrize(("mode", "look_ahead"), [*((mode, None) for mode in Mode), (Mode.STEPPED, 0.0)])
def test_whatever_fails_once_a_scan_that_retries_is_whole(mode: Mode, look_ahead: float | None) -> None:
    healthy = Case(mode, look_ahead=look_ahead)
    run_with_cancel_before(healthy.main, None)
    for number in range(1, healthy.bench.operations):  # the first one is refused
        case = Case(mode, fail_at=number, look_ahead=look_ahead, recovery=Recovery(OnFault.RETRY))
        outcome = run_with_cancel_before(case.main, None)
        assert outcome.error is None, number
        assert case.sink.records.stored == LINES, number
        assert not case.violations(outcome), (number, case.violations(outcome))


@pytest.mark.parametrize("mode", Mode)
def test_cancelled_in_the_middle_of_a_recovery(mode: Mode) -> None:
    """Devices are half open then, and the mirror may be on its way home."""
    for number in (4, 9) if mode is Mode.STEPPED else (9,):
        case = Case(mode, fail_at=number, recovery=Recovery(OnFault.RETRY))
        for outcome in cancel_everywhere(case.main, again_after=(None, 2)):
            assert not case.violations(outcome), (number, outcome, case.violations(outcome))


@pytest.mark.parametrize("mode", Mode)
def test_cancelled_in_a_pause(mode: Mode) -> None:
    case = Case(mode, pause_ms=45)
    for outcome in cancel_everywhere(case.main, again_after=(None, 2)):
        assert not case.violations(outcome), (outcome, case.violations(outcome))


def test_the_fuzz_has_teeth(monkeypatch: pytest.MonkeyPatch) -> None:
    """A cleanup that is merely awaited, as one would write it first, is caught breaking the guarantees."""

    async def naive(steps):
        for step in steps:
            await step.action()
        return []

    monkeypatch.setattr("scanhsi.engine.run.clean_up", naive)
    case = Case(Mode.STEPPED)
    broken = {name for outcome in cancel_everywhere(case.main, again_after=(1,)) for name in case.violations(outcome)}
    assert {"the sink was not closed", "the camera is armed"} & broken


def test_an_orphan_task_would_be_caught() -> None:
    """A camera that leaves a task behind on disarm is reported by the same check."""

    class Litterer(BenchCamera):
        async def disarm(self) -> None:
            self.litter = asyncio.get_running_loop().create_task(asyncio.sleep(1000), name="litter")
            await super().disarm()

    case = Case(Mode.STEPPED, camera=Litterer)
    outcome = run_with_cancel_before(case.main, 30)
    assert "a task was left" in case.violations(outcome)
