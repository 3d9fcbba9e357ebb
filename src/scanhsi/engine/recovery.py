"""After a fault: is the scan to go on, and how does a lost device come back."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress

from scanhsi.clock import now_ns
from scanhsi.devices import FreeRunning, require
from scanhsi.devices.errors import (
    DeviceError,
    DeviceUnavailable,
    DeviceUnsafe,
    FrameLost,
    MotionFailed,
    OutOfRange,
    PositionLost,
    ProtocolError,
    UnsupportedFeature,
)
from scanhsi.engine.cleanup import clean_up
from scanhsi.engine.control import unless
from scanhsi.engine.deadlines import CONNECT_S, STOP_S, Part
from scanhsi.engine.plan import OnFault
from scanhsi.engine.reopening import check_identity, close_anyhow, position_lost
from scanhsi.engine.safety import make_safe
from scanhsi.engine.scan import FLUSH, Scan
from scanhsi.log import get_logger

FIRST_WAIT_S = 0.25
LONGEST_WAIT_S = 5.0
"""Between two attempts to open a device anew; each wait is twice the one before."""

_HOPELESS = (OutOfRange, UnsupportedFeature, DeviceUnavailable)
_DEVICE_IS_THERE = (FrameLost, MotionFailed, PositionLost)
_log = get_logger(__name__)


async def recover(scan: Scan, failures: Sequence[BaseException]) -> list[BaseException]:
    """Make everything ready for another leg, if the plan allows one; return what ends the scan instead.

    What was received is on its way to storage; nothing of it is taken again.
    """
    parts = {_part_of(scan, failure) for failure in failures}
    scan.hold_up("fault", ", ".join(_names(scan, parts)), str(failures[0]))
    if not all(_can_be_mended(scan, failure) for failure in failures):
        return [*failures]
    if scan.taken >= scan.course.lines and scan.faults.recovery.on_fault is OnFault.RETRY:
        scan.did("all lines had been taken")
        return []
    if not scan.faults.may_try_again(scan.taken):
        return [*failures]
    scan.faults.tries[scan.taken] += 1
    _log.warning("a fault: trying again", line=scan.taken, operation="recover", error=str(failures[0]))
    unsafe = await clean_up(make_safe(scan))
    lost = {part for failure in (*failures, *unsafe) if (part := _lost_part(scan, failure)) is not None}
    if lost:
        scan.filled.put_nowait(FLUSH)
        scan.tell_state("recovering")
    until_ns = now_ns() + round(scan.faults.recovery.within_s * 1e9)
    for part in sorted(lost):
        if (error := await _bring_back(scan, part, until_ns)) is not None:
            return [*failures, error]
    scan.watch.forget_faults()
    let_go((*failures, *unsafe))
    return []


def let_go(errors: Iterable[BaseException]) -> None:
    """Drop the tracebacks of errors that are dealt with, and of what led to them.

    Their stack frames hold on to the camera's buffers, and to the errors: circles that only a garbage collection would undo, which
    is rare. A scan of a thousand faults came to hold gigabytes.
    """
    waiting, seen = [*errors], set[int]()
    while waiting:
        one = waiting.pop()
        if id(one) in seen:
            continue
        seen.add(id(one))
        one.__traceback__ = None
        linked = (one.__cause__, one.__context__, *getattr(one, "causes", ()), *getattr(one, "exceptions", ()))
        waiting += [other for other in linked if other is not None]


def _part_of(scan: Scan, failure: BaseException) -> Part | None:
    """Whose fault it is: of what was waited for, or whose name the error bears."""
    if (part := scan.watch.blamed(failure)) is not None:
        return part
    device = getattr(failure, "device", None)
    return next((part for part, name in scan.watch.names.items() if name == device), None)


def _names(scan: Scan, parts: set[Part | None]) -> list[str]:
    return sorted(scan.watch.names[part] for part in parts if part is not None)


def _can_be_mended(scan: Scan, failure: BaseException) -> bool:
    """A device's fault that says nothing bad about the lines that are stored."""
    known = isinstance(failure, DeviceError) and not isinstance(failure, _HOPELESS)
    if not known or failure in scan.faults.final or _part_of(scan, failure) not in (Part.CAMERA, Part.ACTUATOR):
        return False
    return scan.actuator_info.finds_home or not isinstance(failure, PositionLost)


def _lost_part(scan: Scan, failure: BaseException) -> Part | None:
    """The part that has to be opened anew after a failure."""
    cause = failure.__cause__ if isinstance(failure, DeviceUnsafe) else failure
    return None if isinstance(cause, _DEVICE_IS_THERE) else _part_of(scan, failure)


def lost_devices(scan: Scan, failures: Sequence[BaseException]) -> dict[str, str]:
    """Of what ended a scan: the devices that have to be opened anew before they are used again, and what happened to each first."""
    lost: dict[str, str] = {}
    for failure in failures:
        if isinstance(failure, DeviceError) and not isinstance(failure, _HOPELESS):
            part = _lost_part(scan, failure)
            if part is not None and part is not Part.STORAGE:
                lost.setdefault(part.value, str(failure))
    return lost


# --- bringing a device back ---------------------------------------------------------------------------------------------------


async def _bring_back(scan: Scan, part: Part, until_ns: int) -> DeviceError | None:
    """Open a device anew, again and again with growing pauses; the last error when it is not back in time.

    A request to stop ends this: the scan is over then.
    """
    reopen = _reopen_camera if part is Part.CAMERA else _reopen_actuator
    close = scan.camera.close if part is Part.CAMERA else scan.actuator.close
    name = scan.watch.names[part]
    began_ns = now_ns()
    for wait_s in _waits_s():
        await close_anyhow(scan.watch, part, close)
        try:
            async with scan.watch(part, _limit_s(until_ns), "connect"):
                await unless(scan.control.stop.wait(), reopen(scan))
        except DeviceError as error:
            if isinstance(error, PositionLost) or now_ns() + round(wait_s * 1e9) > until_ns:
                scan.did("it did not come back")
                return error
            _log.info("not back yet", device=name, operation="recover", error=str(error))
        else:
            if scan.control.stop.is_set():
                return None
            scan.did(f"{name} opened anew")
            _log.info("back", device=name, operation="recover", waited_s=(now_ns() - began_ns) * 1e-9)
            return None
        with suppress(TimeoutError):
            async with asyncio.timeout(wait_s):
                await scan.control.stop.wait()
        if scan.control.stop.is_set():
            return None
    return None


def _limit_s(until_ns: int) -> float:
    """Of one attempt: no longer than what is left, but for the first one of a very short time."""
    return min(CONNECT_S, max((until_ns - now_ns()) * 1e-9, FIRST_WAIT_S))


def _waits_s() -> Iterator[float]:
    wait_s = FIRST_WAIT_S
    while True:
        yield wait_s
        wait_s = min(2 * wait_s, LONGEST_WAIT_S)


async def _reopen_camera(scan: Scan) -> None:
    """Connect, and set everything as it was."""
    camera, course = scan.camera, scan.course
    await camera.connect()
    check_identity(scan.camera_info, camera.info)
    scan.faults.silent = 0
    applied = await camera.configure(course.settings)
    if applied != course.settings:
        raise ProtocolError(f"it took other settings than before: {applied}.", device=camera.info.name)
    if (period_s := scan.frame_period_s) is not None:
        clock = require(camera, FreeRunning, "mode 'continuous'", name=camera.info.name)
        if await clock.set_frame_period(period_s) != period_s:
            raise ProtocolError("it took another frame period than before.", device=camera.info.name)


async def _reopen_actuator(scan: Scan) -> None:
    """Connect, and see that the mirror stands; it is homed with the next leg, if it has to be."""
    actuator = scan.actuator
    await actuator.connect()
    check_identity(scan.actuator_info, actuator.info)
    async with scan.watch(Part.ACTUATOR, STOP_S, "stop"):
        await actuator.stop()
    scan.distrusted = not _stands_where_it_can(scan)
    if scan.distrusted and not actuator.info.finds_home:
        raise position_lost(actuator.info.name, "recover")


def _stands_where_it_can(scan: Scan) -> bool:
    """Whether the position that is told can be true: a controller that was restarted counts from 0, wherever the mirror stands."""
    if not scan.actuator.homed:
        return False
    try:
        position = scan.actuator.position
    except PositionLost:
        return False
    return scan.between is None or scan.between[0] <= position <= scan.between[1]
