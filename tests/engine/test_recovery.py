"""Faults on the way: what each policy does about them, on the bench, in virtual time."""

from __future__ import annotations

import asyncio
import gc
import logging
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest

from scanhsi.clock import run_virtual
from scanhsi.cube.records import LineStatus
from scanhsi.devices import CameraSettings, Exposure, Motion, PixelFormat, Trigger
from scanhsi.devices.errors import (
    DeviceLost,
    DeviceNotFound,
    DeviceTimeout,
    DeviceUnsafe,
    FrameLost,
    MotionFailed,
    PositionLost,
    ScanFailed,
)
from scanhsi.engine import Course, Mode, OnFault, Progress, Recovery, ScanReport, run_scan
from support.bench import Bench, BenchActuator, BenchCamera, MemorySink

LINES = 12
FIRST_STEP = 10
STEP_MODES = [Mode.SEQUENTIAL, Mode.STEPPED]
RETRY = Recovery(OnFault.RETRY)


def course(mode: Mode, recovery: Recovery, *, stride: int = 1, lines: int = LINES) -> Course:
    steps = FIRST_STEP + stride * np.arange(lines, dtype=np.int64)
    return Course(mode, CameraSettings(0.02, 0.0, PixelFormat.MONO12), steps, steps * 0.1, recovery=recovery)


@dataclass
class Trouble:
    """What goes wrong with the devices below, and what they were asked to do.

    Attributes:
        at: Name of a method -> numbers of its calls that raise, and what.
        away: Connections that are refused after a loss.
        boots_at: Position that the actuator tells when it is connected anew; None keeps it.
        homed_then: Whether it calls itself homed then.
    """

    at: dict[str, dict[int, Exception]] = field(default_factory=dict)
    away: int = 0
    boots_at: int | None = None
    homed_then: bool = True
    calls: list[str] = field(default_factory=list)
    moves: list[int] = field(default_factory=list)

    def call(self, name: str) -> None:
        number = self.calls.count(name)
        self.calls.append(name)
        if (error := self.at.get(name, {}).get(number)) is not None:
            raise error

    def knock(self, device: str) -> None:
        self.calls.append(f"connect {device}")
        if self.away:
            self.away -= 1
            raise DeviceNotFound("nothing answers.", device=device)


class Camera(BenchCamera):
    def __init__(self, bench: Bench, trouble: Trouble) -> None:
        super().__init__(bench)
        self.trouble = trouble
        self.open = True

    async def connect(self) -> None:
        self.trouble.knock("camera")
        self.open = True
        self._settings = CameraSettings(0.5)

    async def close(self) -> None:
        await super().close()
        self.open = False

    async def configure(self, settings: CameraSettings) -> CameraSettings:
        self.trouble.call("configure")
        return await super().configure(settings)

    async def arm(self, trigger: Trigger, buffers: int) -> None:
        assert self.open
        assert self._settings.exposure_s == 0.02, "not configured as it was"
        self.trouble.call("arm")
        await super().arm(trigger, buffers)

    async def expose(self) -> Exposure:
        self.trouble.call("expose")
        return await super().expose()


class Actuator(BenchActuator):
    def __init__(self, bench: Bench, trouble: Trouble, **info: Any) -> None:
        super().__init__(bench)
        self.trouble = trouble
        self.info = replace(self.info, **info)

    async def connect(self) -> None:
        self.trouble.knock("actuator")
        if self.trouble.boots_at is not None:
            self.bench.position, self.bench.homed = self.trouble.boots_at, self.trouble.homed_then

    async def home(self) -> Motion:
        self.trouble.calls.append("home")
        return await super().home()

    async def move_to(self, step: int) -> Motion:
        self.trouble.moves.append(step)
        self.trouble.call("move")
        return await super().move_to(step)

    async def sweep(self, sweep: Any) -> Motion:
        self.trouble.call("sweep")
        return await super().sweep(sweep)

    async def stop(self) -> None:
        self.trouble.call("stop")
        await super().stop()


@dataclass
class Rig:
    """One scan with everything it touches."""

    mode: Mode = Mode.STEPPED
    recovery: Recovery = RETRY
    bench: Bench = field(default_factory=Bench)
    trouble: Trouble = field(default_factory=Trouble)
    sink: MemorySink = field(default_factory=lambda: MemorySink(batch=5, capacity=10))
    stride: int = 1
    actuator_info: dict[str, Any] = field(default_factory=dict)
    states: list[str] = field(default_factory=list)

    async def main(self, **kwargs: Any) -> ScanReport:
        wanted = course(self.mode, self.recovery, stride=self.stride)
        camera = Camera(self.bench, self.trouble)
        actuator = Actuator(self.bench, self.trouble, **self.actuator_info)
        return await run_scan(wanted, camera, actuator, self.sink, on_progress=self._told, **kwargs)

    def _told(self, progress: Progress) -> None:
        if not self.states or self.states[-1] != progress.state:
            self.states.append(progress.state)

    def run(self) -> ScanReport:
        return run_virtual(self.main())

    def fails(self) -> ScanFailed:
        with pytest.raises(ScanFailed) as failed:
            self.run()
        self.check_safe()
        return failed.value

    def check_safe(self) -> None:
        assert (self.bench.stopped, self.bench.armed, self.sink.closed) == (True, False, True)
        assert self.mode is Mode.CONTINUOUS or self.bench.moved_while_exposing() == []

    def check_whole(self, report: ScanReport, missing: tuple[int, ...] = ()) -> None:
        """Every line is what the mirror showed, or missing for a reason."""
        self.check_safe()
        assert (report.stored, tuple(report.missing_reasons)) == (LINES - len(missing), missing)
        assert not report.stopped_early
        for line in range(LINES):
            if line not in missing:
                assert np.all(self.sink.pixels[line] == (FIRST_STEP + line * self.stride) % 256), line
                assert self.sink.records.mirror_step[line] == FIRST_STEP + line * self.stride


def losing(positions: dict[int, int], word: bool = True) -> type[Camera]:
    """A camera that loses the frames of lines, so often each; with or without a word."""
    left = dict(positions)

    class Losing(Camera):
        def _put(self, index: int, start: int, when: int, position: int) -> None:
            line = position - FIRST_STEP
            if left.get(line):
                left[line] -= 1
                self.bench.lose = frozenset({index}) if word else frozenset()
                self.bench.swallow = frozenset() if word else frozenset({index})
            else:
                self.bench.lose = self.bench.swallow = frozenset()
            super()._put(index, start, when, position)

    return Losing


@pytest.fixture
def use_camera(monkeypatch: pytest.MonkeyPatch) -> Callable[[type[Camera]], None]:
    return lambda kind: monkeypatch.setitem(globals(), "Camera", kind)


# --- lost frames ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", STEP_MODES)
@pytest.mark.parametrize("word", [True, False])
def test_a_lost_frame_is_taken_again_at_its_place(mode: Mode, word: bool, use_camera: Any) -> None:
    use_camera(losing({0: 1, 4: 2, 7: 1, LINES - 1: 1}, word))
    rig = Rig(mode)
    report = rig.run()
    rig.check_whole(report)
    assert report.retaken >= 4
    assert [incident.line for incident in report.incidents if "anew" not in incident.action][:2] == [0, 4]
    attempts = rig.sink.records.attempt
    assert (attempts[0], attempts[7]) == (2, 2)
    assert attempts[4] >= 3
    assert report.interrupted_s == pytest.approx(sum(incident.lasted_s for incident in report.incidents))
    assert not [call for call in rig.trouble.calls if call.startswith("connect")] or not word


def test_faults_that_are_dealt_with_hold_on_to_nothing(use_camera: Any) -> None:
    """Without the garbage collector, which comes too seldom: the stack frames of an error hold on to frames of the camera."""
    use_camera(losing(dict.fromkeys(range(1, LINES), 2)))
    gc.collect()
    gc.disable()
    try:
        report = Rig(Mode.STEPPED).run()
        held = [thing for thing in gc.get_objects() if isinstance(thing, FrameLost)]
    finally:
        gc.enable()
    assert len(report.incidents) > 10
    assert len(held) <= 2


def test_the_period_of_a_scan_leaves_interruptions_out(use_camera: Any) -> None:
    whole = Rig(Mode.SEQUENTIAL).run()
    use_camera(losing({LINES - 2: 1}, word=False))  # five seconds of silence
    disturbed = Rig(Mode.SEQUENTIAL).run()
    assert disturbed.interrupted_s < disturbed.duration_s
    assert disturbed.duration_s > 5 > 100 * disturbed.period_s
    assert disturbed.period_s == pytest.approx(whole.period_s, rel=0.3)
    assert disturbed.stages["line"].max_s < 1
    assert disturbed.regret is not None
    assert disturbed.regret >= 1


def test_a_line_that_is_lost_again_and_again_is_given_up(use_camera: Any) -> None:
    use_camera(losing({4: 99, 5: 1}))
    rig = Rig(recovery=Recovery(OnFault.RETRY, line_retries=3))
    report = rig.run()
    rig.check_whole(report, missing=(4,))
    assert report.missing_reasons == {4: "the bench lost it (tried 4 times)"}
    assert rig.sink.records.attempt[4] == 4


def test_retries_are_counted_in_all(use_camera: Any) -> None:
    use_camera(losing(dict.fromkeys(range(2, 8), 1)))
    rig = Rig(recovery=Recovery(OnFault.RETRY, retries=4))
    report = rig.run()
    rig.check_whole(report, missing=(6, 7))
    assert len(report.incidents) == 4


@pytest.mark.parametrize("mode", Mode)
def test_abort_ends_the_scan_with_the_first_lost_frame(mode: Mode, use_camera: Any) -> None:
    use_camera(losing({4: 1}))
    failed = Rig(mode, Recovery(OnFault.ABORT)).fails()
    assert isinstance(failed.causes[0], FrameLost)
    assert "line 4" in str(failed)
    assert failed.stored == 4


@pytest.mark.parametrize("mode", Mode)
@pytest.mark.parametrize("policy", [OnFault.SKIP, OnFault.RETRY])
def test_a_lost_frame_costs_its_line_otherwise(mode: Mode, policy: OnFault, use_camera: Any) -> None:
    if policy is OnFault.RETRY and mode is not Mode.CONTINUOUS:
        pytest.skip("taken again")
    use_camera(losing({4: 1}))
    rig = Rig(mode, Recovery(policy))
    report = rig.run()
    rig.check_whole(report, missing=(4,))
    assert report.incidents == ()


# --- lost devices -----------------------------------------------------------------------------------------------------------


def gone(device: str = "actuator bench") -> DeviceLost:
    return DeviceLost("somebody pulled the plug.", device=device)


@pytest.mark.parametrize("mode", STEP_MODES)
@pytest.mark.parametrize("number", [0, 1, 5, LINES - 1])
def test_a_lost_camera_comes_back(mode: Mode, number: int) -> None:
    rig = Rig(mode, trouble=Trouble({"expose": {number: gone("camera bench")}}, away=3))
    report = rig.run()
    rig.check_whole(report)
    assert rig.trouble.calls.count("connect camera") == 4
    (incident,) = report.incidents
    assert (incident.kind, incident.device) == ("fault", "camera bench")
    assert "pulled the plug" in incident.cause
    assert "camera bench opened anew" in incident.action
    assert incident.lasted_s > 0.25 + 0.5 + 1
    assert rig.states[-2:] == ["recovering", "scanning"]


@pytest.mark.parametrize("mode", STEP_MODES)
@pytest.mark.parametrize("number", [0, 1, 5, LINES - 1])
def test_a_lost_actuator_comes_back_and_is_homed(mode: Mode, number: int) -> None:
    trouble = Trouble({"move": {number: gone()}}, away=2, boots_at=0, homed_then=False)
    rig = Rig(mode, trouble=trouble)
    report = rig.run()
    rig.check_whole(report)
    assert trouble.calls.count("home") == 1
    assert "homed" in report.incidents[0].action


def test_a_lost_actuator_that_stands_where_it_was_is_not_homed() -> None:
    rig = Rig(trouble=Trouble({"move": {5: gone()}}))
    rig.check_whole(rig.run())
    assert "home" not in rig.trouble.calls


@pytest.mark.parametrize("boots_at", [0, 4000])
def test_an_actuator_that_wrongly_thinks_itself_homed_is_homed_all_the_same(boots_at: int) -> None:
    """A controller that was restarted counts from anywhere: its soft limits would lie elsewhere."""
    rig = Rig(trouble=Trouble({"move": {5: gone()}}, boots_at=boots_at))
    rig.check_whole(rig.run())
    assert rig.trouble.calls.count("home") == 1


@pytest.mark.parametrize("homed_then", [False, True])
def test_a_drive_that_cannot_find_its_home_does_not_go_on_elsewhere(homed_then: bool) -> None:
    trouble = Trouble({"move": {5: gone()}}, boots_at=0, homed_then=homed_then)
    failed = Rig(trouble=trouble, actuator_info={"finds_home": False}).fails()
    assert isinstance(failed.causes[-1], PositionLost)
    assert "home switch" in str(failed)
    assert max(trouble.moves) == trouble.moves[-1], "nothing moved after the loss"


@pytest.mark.parametrize("error", [PositionLost("it was reset.", device="actuator bench"), MotionFailed("it stalled.")])
def test_a_motion_that_failed_is_made_again_without_reopening(error: Exception) -> None:
    rig = Rig(trouble=Trouble({"move": {5: error}}))
    rig.check_whole(rig.run())
    assert "connect actuator" not in rig.trouble.calls


@pytest.mark.parametrize("policy", [OnFault.SKIP, OnFault.ABORT])
def test_without_retry_a_lost_device_ends_the_scan(policy: OnFault) -> None:
    rig = Rig(recovery=Recovery(policy), trouble=Trouble({"move": {5: gone()}}))
    failed = rig.fails()
    assert failed.stored == 4  # the frame of line 4 was on its way
    assert "connect actuator" not in rig.trouble.calls
    (incident,) = rig.sink.records.incidents
    assert incident.action == "the scan ended"


def test_a_device_that_does_not_come_back_in_time_ends_the_scan() -> None:
    rig = Rig(
        recovery=Recovery(OnFault.RETRY, within_s=20.0),
        trouble=Trouble({"expose": {5: gone("camera bench")}}, away=999),
    )
    failed = rig.fails()
    assert isinstance(failed.causes[0], DeviceLost)
    assert isinstance(failed.causes[-1], DeviceNotFound)
    assert failed.stored == 4
    assert 4 < rig.trouble.calls.count("connect camera") < 10
    (incident,) = rig.sink.records.incidents
    assert 10 < incident.lasted_s < 21


def test_a_line_at_which_devices_are_lost_again_and_again_ends_the_scan() -> None:
    rig = Rig(trouble=Trouble({"expose": {number: gone("camera bench") for number in range(6, 99)}}))
    failed = rig.fails()
    assert failed.stored == 5
    assert 3 <= rig.trouble.calls.count("connect camera") <= 4


def test_both_devices_lost_at_once() -> None:
    trouble = Trouble({"expose": {5: gone("camera bench")}, "stop": {0: gone()}})
    rig = Rig(trouble=trouble)
    report = rig.run()
    rig.check_whole(report)
    assert {"connect camera", "connect actuator"} <= set(trouble.calls)


def test_another_device_at_the_address_is_not_scanned_with(use_camera: Any) -> None:
    class Swapped(Camera):
        async def connect(self) -> None:
            await super().connect()
            self.info = replace(self.info, serial="2")

    use_camera(Swapped)
    failed = Rig(trouble=Trouble({"expose": {5: gone("camera bench")}})).fails()
    assert "another device answers" in str(failed)


def test_a_bug_is_not_retried() -> None:
    rig = Rig(trouble=Trouble({"expose": {5: ZeroDivisionError("bug")}}))
    failed = rig.fails()
    assert isinstance(failed.causes[0], ZeroDivisionError)
    assert "connect camera" not in rig.trouble.calls


@pytest.mark.parametrize("policy", OnFault)
def test_storage_that_fails_is_not_retried(policy: OnFault) -> None:
    rig = Rig(recovery=Recovery(policy), sink=MemorySink(fail_at_line=6))
    failed = rig.fails()
    assert isinstance(failed.causes[0], OSError)


def test_what_was_received_is_stored_while_a_device_is_away() -> None:
    """Also what does not fill a shard: the device may never come back."""
    seen: list[int] = []
    rig = Rig(sink=MemorySink(batch=50, capacity=60))

    class Late(Trouble):
        def knock(self, device: str) -> None:
            super().knock(device)
            seen.append(rig.sink.records.stored)

    rig.trouble = Late({"expose": {5: gone("camera bench")}}, away=2)
    rig.check_whole(rig.run())
    assert seen[-1] >= 4


# --- sweeps -----------------------------------------------------------------------------------------------------------------


def test_a_sweep_goes_on_with_the_first_line_not_received(use_camera: Any) -> None:
    class Unplugged(Camera):
        """The camera goes away in mid-sweep."""

        async def arm(self, trigger: Trigger, buffers: int) -> None:
            await super().arm(trigger, buffers)
            if self.trouble.calls.count("arm") == 1:
                asyncio.get_running_loop().call_later(0.15, self._channel.fail, gone("camera bench"))

    use_camera(Unplugged)
    rig = Rig(Mode.CONTINUOUS)
    report = rig.run()
    rig.check_whole(report)
    (incident,) = report.incidents
    assert 0 < incident.line < LINES
    assert rig.sink.records.attempt[incident.line] == 2
    assert rig.sink.records.attempt[0] == 1


@pytest.mark.parametrize("stride", [1, -2])
def test_a_lost_actuator_in_a_sweep(stride: int) -> None:
    class Stumbling(Actuator):
        stumbled = False

        async def sweep(self, sweep: Any) -> Motion:
            motion = asyncio.ensure_future(super().sweep(sweep))
            await asyncio.sleep(0.13)
            if not self.stumbled:
                type(self).stumbled = True
                motion.cancel()
                raise gone()
            return await motion

    rig = Rig(Mode.CONTINUOUS, stride=stride, trouble=Trouble(boots_at=0, homed_then=False))
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(globals(), "Actuator", Stumbling)
        report = rig.run()
    rig.check_whole(report)
    assert rig.trouble.calls.count("home") == 1


# --- where the mirror comes from ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("stride", [3, -3])
def test_the_mirror_comes_to_a_line_from_the_side_of_the_lines_before(stride: int, use_camera: Any) -> None:
    rig = Rig(stride=stride, trouble=Trouble({"expose": {5: gone("camera bench")}}))
    rig.check_whole(rig.run())
    moves = rig.trouble.moves
    again = [index for index, step in enumerate(moves) if step == FIRST_STEP + 4 * stride][-1]
    assert (moves[again] - moves[again - 1]) * np.sign(stride) >= 64


def test_the_approach_stays_within_the_limits() -> None:
    rig = Rig(trouble=Trouble({"expose": {2: gone("camera bench")}}), actuator_info={})

    async def main() -> ScanReport:
        from scanhsi.devices import Range

        return await rig.main(limits=Range(FIRST_STEP - 3, 500, 1, "steps"))

    rig.check_whole(run_virtual(main()))
    assert min(rig.trouble.moves) == FIRST_STEP - 3


# --- watchdogs, and what is unsafe --------------------------------------------------------------------------------------------


async def _for_ever(*_: object) -> Any:
    await asyncio.Event().wait()


def after(method: Callable[..., Awaitable[Any]], calls: int) -> Callable[..., Awaitable[Any]]:
    """The method, which never returns after so many calls."""
    count = [0]

    async def sometimes(*args: Any) -> Any:
        count[0] += 1
        return await (method(*args) if count[0] <= calls else _for_ever())

    return sometimes


@pytest.mark.parametrize(
    ("device", "method", "words"),
    [
        (Camera, "expose", "camera bench, expose, line 7, waited 5.03 s.*last heard of it: .* before"),
        (Camera, "unpack", "camera bench, unpack, line 7, waited 5.01 s.*last heard of it: .* of line .* s before"),
        (Actuator, "move_to", "actuator bench, move_to 17, line 7, waited 5 s.*last heard of it: move_to 16 of line 6, 5.0"),
        (MemorySink, "append", "storage, store, line 7, waited 60 s.*last heard of it: store of line 6, 60 s before"),
    ],
)  # fmt: skip
def test_a_watchdog_names_stage_line_wait_and_what_was_heard_last(
    device: type, method: str, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(device, method, after(getattr(device, method), 7))
    with pytest.raises(ScanFailed, match=words) as failed:
        Rig(recovery=Recovery(), sink=MemorySink(capacity=20)).run()
    assert isinstance(failed.value.causes[0], DeviceTimeout)


def test_a_silent_camera_names_what_was_heard_last() -> None:
    rig = Rig(recovery=Recovery(), bench=Bench(swallow=frozenset(range(5, 99))))
    assert "last heard of it: " in str(rig.fails().causes[0])


def test_a_silent_camera_is_opened_anew(use_camera: Any) -> None:
    use_camera(losing({5: 3}, word=False))
    rig = Rig(Mode.SEQUENTIAL)
    report = rig.run()
    rig.check_whole(report)
    assert rig.trouble.calls.count("connect camera") == 1


def test_a_mirror_that_does_not_confirm_its_stop_is_unsafe_loudly(caplog: pytest.LogCaptureFixture) -> None:
    rig = Rig(recovery=Recovery(), trouble=Trouble({"stop": dict.fromkeys(range(9), gone())}))
    with pytest.raises(ScanFailed, match="UNSAFE, the mirror may be moving") as failed:
        rig.run()
    (unsafe,) = failed.value.unsafe
    assert isinstance(unsafe, DeviceUnsafe)
    assert unsafe.device == "actuator bench"
    assert [record for record in caplog.records if record.levelno == logging.CRITICAL]
    assert (rig.bench.armed, rig.sink.closed) == (False, True)


def test_a_scan_that_is_stopped_while_a_device_is_away_ends_at_once() -> None:
    rig = Rig(trouble=Trouble({"expose": {5: gone("camera bench")}}, away=999))

    async def main() -> ScanReport:
        stop = asyncio.Event()
        asyncio.get_running_loop().call_later(2.0, stop.set)
        return await rig.main(stop=stop)

    report = run_virtual(main())
    rig.check_safe()
    assert (report.stored, report.stopped_early) == (4, True)
    assert report.duration_s < 2.5


def test_records_of_a_line_that_is_given_up_hold_nothing_of_its_tries(use_camera: Any) -> None:
    use_camera(losing({4: 99}))
    rig = Rig(recovery=Recovery(OnFault.RETRY, line_retries=1))
    rig.run()
    records = rig.sink.records
    assert records.status[4] == LineStatus.MISSING
    assert records.frame_id[4] == -1


def test_a_scan_is_stopped_also_while_a_device_hangs_in_being_opened(use_camera: Any) -> None:
    class Hangs(Camera):
        async def connect(self) -> None:
            await _for_ever()

    use_camera(Hangs)
    rig = Rig(trouble=Trouble({"expose": {5: gone("camera bench")}}))

    async def main() -> ScanReport:
        stop = asyncio.Event()
        asyncio.get_running_loop().call_later(2.0, stop.set)
        return await rig.main(stop=stop)

    report = run_virtual(main())
    rig.check_safe()
    assert report.stopped_early
    assert report.duration_s < 2.5


def test_the_time_limit_holds_also_for_a_device_that_hangs_in_being_opened(use_camera: Any) -> None:
    class Hangs(Camera):
        async def connect(self) -> None:
            await _for_ever()

    use_camera(Hangs)
    rig = Rig(recovery=Recovery(OnFault.RETRY, within_s=10.0), trouble=Trouble({"expose": {5: gone("camera bench")}}))
    failed = rig.fails()
    assert isinstance(failed.causes[-1], DeviceTimeout)
    assert rig.sink.records.incidents[0].lasted_s == pytest.approx(10, abs=0.5)
