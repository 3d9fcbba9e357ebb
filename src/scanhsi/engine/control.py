"""Control: move the mirror and expose. One function a mode, over the same devices.

In the step modes the mirror is told to move only after ``Camera.expose`` has returned, which is the end of the exposure: that
sequence is the interlock which keeps the mirror still from trigger to end of exposure. Only `look_ahead_and_expose`, which has
to be asked for, gives it up, for moves that take a while to begin.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any, TypeVar

from scanhsi.clock import sleep_until_ns
from scanhsi.devices import Actuator, Camera, ForetellsEnd, Motion, Sweep, Sweeps, TellsStart, require
from scanhsi.devices.errors import MotionFailed, ProtocolError
from scanhsi.engine.deadlines import STOP_S, Part
from scanhsi.engine.plan import Mode
from scanhsi.engine.scan import Scan

T = TypeVar("T")

APPROACH_STEPS = 64
"""The mirror comes to a line that is taken again from the same side as before, from so many steps off: two full steps of a motor
with 32 microsteps each, more than a belt gives way."""


async def step_and_expose(scan: Scan) -> None:
    """Sequential and stepped scans: for each line move, take a credit, expose.

    The mirror stands at the first line already. A stepped scan moves on as soon as the exposure has ended; a sequential one waits
    until the line has been handed over to storage.
    """
    sequential = scan.course.mode is Mode.SEQUENTIAL
    leg = scan.leg
    for line in range(leg.first, scan.course.lines):
        if line > leg.first:
            if sequential:
                await _turn(scan, line)
            if scan.control.halted:
                break
            await _move(scan, line)
        else:
            scan.records.mirror_step[line] = scan.actuator.position
        await _credit(scan, line)
        await _expose(scan, line)
        leg.exposed.put_nowait(line)
    leg.exposed.put_nowait(None)


async def look_ahead_and_expose(scan: Scan) -> None:
    """Stepped scans that send each move while the exposure before it is under way, so that the motion begins as that ends.

    Nothing of it is left behind: the move sent ahead is waited for before anything else is done, and cancelled where the exposure
    fails; the mirror is stopped on every way out of a scan. A line is handed on when it is known whether it was smeared.
    """
    leg = scan.leg
    scan.records.mirror_step[leg.first] = scan.actuator.position
    last = scan.course.lines - 1
    for line in range(leg.first, last + 1):
        await _credit(scan, line)
        moved_on = False
        if line < last:
            moved_on = await _expose_and_move_on(scan, line)
        else:
            await _expose(scan, line)
        leg.exposed.put_nowait(line)
        if scan.control.halted or not moved_on:
            break
    leg.exposed.put_nowait(None)


async def _expose_and_move_on(scan: Scan, line: int) -> bool:
    """False: it has not moved on, because of a stop or of a pause, which may be over by now."""
    foretold: asyncio.Future[int] = asyncio.get_running_loop().create_future()
    async with asyncio.TaskGroup() as both:
        moving = both.create_task(_move_ahead(scan, line + 1, foretold), name="move ahead")
        await _expose(scan, line, foretold.set_result)
        if not foretold.done():
            raise ProtocolError(
                "the camera did not tell the end of the exposure.", device=scan.camera_info.name, line=line
            )
    started_ns = moving.result()
    if started_ns is not None:
        scan.records.smeared[line] = started_ns < scan.records.stamps["exposure_end"][line]
    return started_ns is not None


async def _move_ahead(scan: Scan, line: int, foretold: asyncio.Future[int]) -> int | None:
    """Move to ``line`` so that the motion begins as the exposure ends; return when it began. None: stopped before."""
    assert scan.latencies is not None
    end_ns = await foretold
    least_s = as_telling_start(scan.actuator).least_latency_s(int(scan.course.steps[line]))
    await sleep_until_ns(end_ns - scan.latencies.lead_ns(round(least_s * 1e9)))
    if scan.control.halted:
        return None
    motion = await _move(scan, line)
    if motion.started_ns is None:
        raise ProtocolError(
            "it did not tell when the motion began.", device=scan.actuator_info.name, operation="move_to", line=line
        )
    scan.latencies.add(motion.started_ns - motion.commanded_ns)
    return motion.started_ns


async def _move(scan: Scan, line: int) -> Motion:
    step = int(scan.course.steps[line])
    scan.between = _span(scan, int(scan.course.steps[line - 1]), step)
    async with scan.watch(Part.ACTUATOR, scan.deadlines.move_s, f"move_to {step}", line=line):
        motion = await scan.actuator.move_to(step)
        arrived(scan, motion, line)
    stamps = scan.records.stamps
    stamps["commanded"][line] = motion.commanded_ns
    stamps["moved"][line] = motion.moved_ns
    if motion.started_ns is not None:
        stamps["started"][line] = motion.started_ns
    scan.records.mirror_step[line] = motion.step
    return motion


def arrived(scan: Scan, motion: Motion, line: int) -> None:
    """Check that a motion ended at the step of ``line``.

    Raises:
        MotionFailed: It did not.
    """
    step = int(scan.course.steps[line])
    if motion.step != step:
        raise MotionFailed(
            f"the mirror stands at step {motion.step}, not at {step}.", device=scan.actuator_info.name, line=line
        )
    scan.between = step, step


def _span(scan: Scan, here: int, there: int) -> tuple[int, int]:
    """Lowest and highest step on the way, also where the drive arrives from below."""
    return min(here, there) - scan.actuator_info.backlash_steps, max(here, there)


async def approach(scan: Scan) -> bool:
    """Move to the first line of a leg; False when a stop or a pause came before the mirror was there.

    But for the very first line of a scan, it comes from where the lines before lie, so that the play of the drive is taken up as
    it was for them.
    """
    line = scan.leg.first
    step = int(scan.course.steps[line])
    first_ever = line == 0 and len(scan.leg_starts) == 1
    for goal in (step,) if first_ever else (_way_off(scan, step), step):
        async with scan.watch(Part.ACTUATOR, scan.deadlines.first_move_s, f"move_to {goal}", line=line):
            scan.between = _span(scan, scan.actuator.position, goal)
            motion = await unless_halted(scan, scan.actuator.move_to(goal))
            if motion is not None and goal == step:
                arrived(scan, motion, line)
        if motion is None:
            return False
    return True


def _way_off(scan: Scan, step: int) -> int:
    """Where the last way to ``step`` begins; within the limits."""
    stride = scan.course.stride
    if not stride:
        return step
    off = max(APPROACH_STEPS, scan.actuator_info.backlash_steps, abs(stride))
    goal = step - off if stride > 0 else step + off
    return int(min(max(goal, scan.limits.minimum), scan.limits.maximum))


async def _expose(scan: Scan, line: int, foretold: Callable[[int], None] | None = None) -> None:
    camera = scan.camera
    scan.records.attempt[line] += 1
    async with scan.watch(Part.CAMERA, scan.deadlines.expose_s, "expose", line=line):
        exposure = await (camera.expose() if foretold is None else as_foretelling(camera).expose_foretold(foretold))
        if exposure.index != line - scan.leg.first:
            raise ProtocolError(
                f"the camera counts this exposure as {exposure.index}, it is {line - scan.leg.first}.",
                device=scan.camera_info.name,
                line=line,
            )
    stamps = scan.records.stamps
    stamps["trigger"][line] = exposure.trigger_ns
    stamps["exposure_start"][line] = exposure.start_ns
    stamps["exposure_end"][line] = exposure.end_ns
    if scan.begun_ns is None:
        scan.begun_ns = exposure.trigger_ns


async def _credit(scan: Scan, line: int) -> None:
    """Wait for free buffers: the trigger waits for them, so that a slow writer costs time and never a line."""
    if not scan.credits.may_expose(line):
        async with scan.watch(Part.STORAGE, scan.deadlines.store_s, "wait for a line buffer", line=line):
            await scan.credits.wait(line)


async def _turn(scan: Scan, line: int) -> None:
    limit_s = scan.deadlines.frame_s + scan.deadlines.store_s
    async with scan.watch(Part.STORAGE, limit_s, "wait for the last line to be handed over", line=line):
        await scan.credits.turn(line)


async def sweep_past(scan: Scan, sweep: Sweep) -> None:
    """Continuous scans: run the prepared sweep; the frames come as the mirror passes, or as the camera's clock beats.

    A stop or a pause ends the motion; the lines that were passed by then are kept.
    """
    leg = scan.leg
    actuator = as_sweeping(scan.actuator)
    limit_s = scan.deadlines.first_move_s + 2 * (actuator.run_up_s(sweep) + sweep.count * sweep.period_s)
    scan.between = actuator.extent(sweep)
    async with scan.watch(Part.ACTUATOR, limit_s, "sweep", line=leg.first):
        motion = await unless_halted(scan, actuator.sweep(sweep))
    if motion is None:
        leg.cut = True
        async with scan.watch(Part.ACTUATOR, STOP_S, "stop"):
            await scan.actuator.stop()
        await asyncio.sleep(scan.settling_s)
        async with scan.watch(Part.CAMERA, STOP_S, "disarm"):
            await scan.camera.disarm()  # which ends the frames
    elif sweep.pulses and motion.pulses != sweep.count:
        told = f"{motion.pulses} trigger pulses were given on the way, not {sweep.count}."
        raise scan.faults.beyond_repair(MotionFailed(told, device=scan.actuator_info.name))
    leg.motion_over.set()


def as_sweeping(actuator: Actuator) -> Sweeps:
    """The actuator as one that sweeps.

    Raises:
        UnsupportedFeature: It cannot.
    """
    return require(actuator, Sweeps, "mode 'continuous'", name=actuator.info.name)


def as_telling_start(actuator: Actuator) -> TellsStart:
    """The actuator as one that tells when its motions begin.

    Raises:
        UnsupportedFeature: It cannot.
    """
    return require(actuator, TellsStart, "look-ahead", name=actuator.info.name)


def as_foretelling(camera: Camera) -> ForetellsEnd:
    """The camera as one that tells the end of an exposure while it lasts.

    Raises:
        UnsupportedFeature: It cannot.
    """
    return require(camera, ForetellsEnd, "look-ahead", name=camera.info.name)


async def unless_halted(scan: Scan, motion: Coroutine[None, None, Motion]) -> Motion | None:
    """Run a motion to its end, or cancel it when the scan is to stop or pause, or do not begin it at all; None then."""
    if scan.control.halted:
        motion.close()
        return None
    return await unless(scan.control.until_halted(), motion)


async def unless(ended: Coroutine[Any, Any, object], work: Coroutine[Any, Any, T]) -> T | None:
    """Run work to its end, or cancel it when ``ended`` comes first; None then."""
    working, waiting = asyncio.ensure_future(work), asyncio.ensure_future(ended)
    try:
        await asyncio.wait([working, waiting], return_when=asyncio.FIRST_COMPLETED)
        return working.result() if working.done() else None
    finally:
        working.cancel()
        waiting.cancel()
        await asyncio.gather(working, waiting, return_exceptions=True)
