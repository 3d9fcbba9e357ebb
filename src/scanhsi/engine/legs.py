"""The legs of a scan: stretches without interruption, each with the camera armed once, over one open sink and one writer.

A scan that nothing disturbs is one leg. A pause or a fault ends a leg; the next one begins with the first line not received.
"""

from __future__ import annotations

import asyncio
import traceback
from collections.abc import Callable, Coroutine
from functools import partial
from typing import Any, cast

from scanhsi.devices import Sighting, Sweep, Trigger
from scanhsi.devices.errors import DeviceTimeout, PositionLost, ScanhsiError
from scanhsi.engine.cleanup import clean_up
from scanhsi.engine.control import (
    approach,
    as_sweeping,
    look_ahead_and_expose,
    step_and_expose,
    sweep_past,
    unless_halted,
)
from scanhsi.engine.deadlines import HOME_S, STOP_S, Part
from scanhsi.engine.light import light_up, lights_off
from scanhsi.engine.receive import receive_exposed, write_lines
from scanhsi.engine.recovery import recover
from scanhsi.engine.safety import leave_safe, make_safe
from scanhsi.engine.scan import CAMERA_BUFFERS, FLUSH, Scan
from scanhsi.engine.sweep import Events, Places, passing_ns, receive_sweep

TakeLeg = Callable[[], Coroutine[None, None, None]]


async def acquire(scan: Scan, take_leg: TakeLeg) -> None:
    """Take all lines and store them.

    Raises:
        BaseExceptionGroup: What ended the scan; lines that were received before are stored, unless storage is what failed.
    """
    await light_up(scan)
    async with asyncio.TaskGroup() as tasks:
        tasks.create_task(write_lines(scan), name="write")
        leading = tasks.create_task(_lead(scan, take_leg), name="lead")
    if failures := leading.result():
        raise BaseExceptionGroup("the scan ended early", failures)


async def _lead(scan: Scan, take_leg: TakeLeg) -> list[BaseException]:
    """One leg after the other, until no line is left or none is wanted; return what ended the scan before that."""
    failures: list[BaseException] = []
    while not (scan.over or failures):
        if scan.control.paused:
            failures = await _pause(scan)
        else:
            scan.begin_leg()
            failures, cancelled = await finish(take_leg())
            if cancelled:
                raise BaseExceptionGroup("while being cancelled", failures) if failures else asyncio.CancelledError
            if not (scan.over or failures):  # a pause ended it, which may be over already
                failures = await _pause(scan)
        if failures:
            failures = await recover(scan, failures)
    await clean_up(leave_safe(scan) if failures else lights_off(scan))  # now, for the writer may take its time
    scan.filled.put_nowait(None)
    return failures


async def _pause(scan: Scan) -> list[BaseException]:
    """Stand still until somebody says to go on, or to stop; return what could not be made safe."""
    scan.hold_up("pause", "", "asked for")
    if failures := await clean_up(make_safe(scan)):
        return [*failures]
    scan.filled.put_nowait(FLUSH)
    scan.control.standing.set()
    scan.tell_state("paused")
    try:
        await scan.control.until_going()
    finally:
        scan.control.standing.clear()
    return []


async def finish(work: Coroutine[Any, Any, None]) -> tuple[list[BaseException], bool]:
    """Run work in a task of its own to its end; return what went wrong in it, first cause first, and whether we were cancelled.

    So a cancellation is seen as what it is, whatever a task group that fails at the same time makes of it (CPython 3.11 and 3.12
    leave the count of cancellations too high). It is the caller's to go on with.
    """
    task = asyncio.ensure_future(work)
    cancelled = False
    while not task.done():
        try:
            await asyncio.wait([task])
        except asyncio.CancelledError:
            cancelled = True
            task.cancel()
    if not task.cancelled():
        error = task.exception()
        return ([] if error is None else leaves(error)), cancelled
    return ([] if cancelled else [ScanhsiError("a task of the scan was cancelled from outside.")]), cancelled


def leaves(error: BaseException) -> list[BaseException]:
    """The exceptions of a group, scanhsi's own first, for they say most, and deadlines behind what made others wait."""
    if not isinstance(error, BaseExceptionGroup):
        return [error]
    group = cast(BaseExceptionGroup[BaseException], error)
    # It is done with, but the stack frame of the task group that raised it holds on to it: see `let_go`.
    traceback.clear_frames(group.__traceback__)
    group.__traceback__ = None
    found = [leaf for part in group.exceptions for leaf in leaves(part)]
    return sorted(found, key=lambda leaf: (not isinstance(leaf, ScanhsiError), isinstance(leaf, DeviceTimeout)))


# --- step modes -------------------------------------------------------------------------------------------------------------


async def take_steps(scan: Scan) -> None:
    """A leg of a sequential or stepped scan."""
    await _find_home(scan)
    if not await approach(scan):
        return
    await _arm(scan, Trigger.SOFTWARE)
    scan.going_on(f"went on with line {scan.leg.first}")
    control = step_and_expose if scan.latencies is None else look_ahead_and_expose
    async with asyncio.TaskGroup() as tasks:
        tasks.create_task(control(scan), name="control")
        tasks.create_task(receive_exposed(scan), name="receive")


# --- sweeps -----------------------------------------------------------------------------------------------------------------


async def take_sweep(scan: Scan, trigger: Trigger, period_s: float) -> None:
    """A leg of a continuous scan."""
    await _find_home(scan)
    actuator = as_sweeping(scan.actuator)
    sweep = plan_sweep(scan, trigger, period_s)
    async with scan.watch(Part.ACTUATOR, scan.deadlines.first_move_s, "prepare_sweep", line=scan.leg.first):
        scan.between = _with(actuator.extent(sweep), scan.actuator.position)
        motion = await unless_halted(scan, actuator.prepare_sweep(sweep))
    if motion is None:
        return
    await _arm(scan, trigger)
    scan.going_on(f"went on with line {scan.leg.first}")
    passing = passing_ns(actuator.run_up_s(sweep))
    if scan.begun_ns is None:
        scan.begun_ns = passing
    events = Events(scan)
    places = Places(sweep, scan.leg.first, trigger, passing, partial(_locate, scan), events.reach)
    async with asyncio.TaskGroup() as tasks:
        tasks.create_task(sweep_past(scan, sweep), name="control")
        tasks.create_task(receive_sweep(scan, sweep, events, places), name="receive")


def plan_sweep(scan: Scan, trigger: Trigger, period_s: float) -> Sweep:
    """The sweep of the lines that are left, as the actuator will run it.

    Raises:
        OutOfRange: It leaves the limits.
    """
    actuator, course = as_sweeping(scan.actuator), scan.course
    sweep = actuator.check_sweep(
        Sweep(
            first=int(course.steps[scan.taken]),
            every=course.stride,
            count=course.lines - scan.taken,
            rate_steps_s=abs(course.stride) / period_s,
            pulses=trigger is Trigger.LINE,
        )
    )
    for step in actuator.extent(sweep):
        scan.limits.check("end of the sweep's run-up or run-out", step, device=scan.actuator_info.name)
    return sweep


def _with(extent: tuple[int, int], step: int) -> tuple[int, int]:
    return min(extent[0], step), max(extent[1], step)


async def _locate(scan: Scan) -> Sighting:
    async with scan.watch(Part.ACTUATOR, STOP_S, "locate"):
        return await as_sweeping(scan.actuator).locate()


# --- both -------------------------------------------------------------------------------------------------------------------


async def _find_home(scan: Scan) -> None:
    """Home where that is due. A stop or a pause ends this, as each motion before the first line, at once: no line is under way."""
    if await _knows_its_position(scan):
        return
    again = len(scan.leg_starts) > 1
    async with scan.watch(Part.ACTUATOR, HOME_S, "home", line=scan.leg.first if again else None):
        if await unless_halted(scan, scan.actuator.home()) is not None:
            scan.did("homed")
            scan.between, scan.distrusted = (0, 0), False


async def _knows_its_position(scan: Scan) -> bool:
    if scan.distrusted or not scan.actuator.homed:
        return False
    try:
        return scan.actuator.position is not None  # pyright: ignore[reportUnnecessaryComparison] raises when it is lost
    except PositionLost:
        return False


async def _arm(scan: Scan, trigger: Trigger) -> None:
    async with scan.watch(Part.CAMERA, scan.deadlines.expose_s, "arm"):
        await scan.camera.arm(trigger, CAMERA_BUFFERS)
