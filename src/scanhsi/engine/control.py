"""Control: move the mirror and expose. One function a mode, over the same devices.

In the step modes the mirror is told to move only after ``Camera.expose`` has returned, which is the end of the exposure: that
sequence is the interlock which keeps the mirror still from trigger to end of exposure. Only `look_ahead_and_expose`, which has
to be asked for, gives it up, for moves that take a while to begin.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine

from scanhsi.clock import sleep_until_ns
from scanhsi.devices import Actuator, Camera, ForetellsEnd, Motion, Sweep, Sweeps, TellsStart, require
from scanhsi.devices.errors import MotionFailed, ProtocolError
from scanhsi.engine.deadlines import STOP_S, Deadline
from scanhsi.engine.plan import Mode
from scanhsi.engine.scan import Scan


async def step_and_expose(scan: Scan) -> None:
    """Sequential and stepped scans: for each line move, take a credit, expose.

    The mirror stands at line 0 already. A stepped scan moves on as soon as the exposure has ended; a sequential one waits until
    the line has been handed over to storage.
    """
    sequential = scan.course.mode is Mode.SEQUENTIAL
    for line in range(scan.course.lines):
        if line:
            if sequential:
                await _turn(scan, line)
            if scan.stop.is_set():
                break
            await _move(scan, line)
        else:
            scan.records.mirror_step[0] = scan.actuator.position
        await _credit(scan, line)
        await _expose(scan, line)
        scan.exposed.put_nowait(line)
    scan.exposed.put_nowait(None)


async def look_ahead_and_expose(scan: Scan) -> None:
    """Stepped scans that send each move while the exposure before it is under way, so that the motion begins as that ends.

    Nothing of it is left behind: the move sent ahead is waited for before anything else is done, and cancelled where the exposure
    fails; the mirror is stopped on every way out of a scan. A line is handed on when it is known whether it was smeared.
    """
    scan.records.mirror_step[0] = scan.actuator.position
    last = scan.course.lines - 1
    for line in range(last + 1):
        await _credit(scan, line)
        if line < last:
            await _expose_and_move_on(scan, line)
        else:
            await _expose(scan, line)
        scan.exposed.put_nowait(line)
        if scan.stop.is_set():
            break
    scan.exposed.put_nowait(None)


async def _expose_and_move_on(scan: Scan, line: int) -> None:
    foretold: asyncio.Future[int] = asyncio.get_running_loop().create_future()
    async with asyncio.TaskGroup() as both:
        moving = both.create_task(_move_ahead(scan, line + 1, foretold), name="move ahead")
        await _expose(scan, line, foretold.set_result)
        if not foretold.done():
            raise ProtocolError(
                "the camera did not tell the end of the exposure.", device=scan.camera.info.name, line=line
            )
    started_ns = moving.result()
    if started_ns is not None:
        scan.records.smeared[line] = started_ns < scan.records.stamps["exposure_end"][line]


async def _move_ahead(scan: Scan, line: int, foretold: asyncio.Future[int]) -> int | None:
    """Move to ``line`` so that the motion begins as the exposure ends; return when it began. None: stopped before."""
    assert scan.latencies is not None
    end_ns = await foretold
    least_s = as_telling_start(scan.actuator).least_latency_s(int(scan.course.steps[line]))
    await sleep_until_ns(end_ns - scan.latencies.lead_ns(round(least_s * 1e9)))
    if scan.stop.is_set():
        return None
    motion = await _move(scan, line)
    if motion.started_ns is None:
        raise ProtocolError(
            "it did not tell when the motion began.", device=scan.actuator.info.name, operation="move_to", line=line
        )
    scan.latencies.add(motion.started_ns - motion.commanded_ns)
    return motion.started_ns


async def _move(scan: Scan, line: int) -> Motion:
    step = int(scan.course.steps[line])
    async with Deadline(scan.deadlines.move_s, f"move_to {step}", device=scan.actuator.info.name, line=line):
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
            f"the mirror stands at step {motion.step}, not at {step}.", device=scan.actuator.info.name, line=line
        )


async def _expose(scan: Scan, line: int, foretold: Callable[[int], None] | None = None) -> None:
    camera = scan.camera
    async with Deadline(scan.deadlines.expose_s, "expose", device=camera.info.name, line=line):
        exposure = await (camera.expose() if foretold is None else as_foretelling(camera).expose_foretold(foretold))
    if exposure.index != line:
        raise ProtocolError(
            f"the camera counts this exposure as {exposure.index}.", device=scan.camera.info.name, line=line
        )
    stamps = scan.records.stamps
    stamps["trigger"][line] = exposure.trigger_ns
    stamps["exposure_start"][line] = exposure.start_ns
    stamps["exposure_end"][line] = exposure.end_ns
    if not line:
        scan.begun_ns = exposure.trigger_ns


async def _credit(scan: Scan, line: int) -> None:
    """Wait for free buffers: the trigger waits for them, so that a slow writer costs time and never a line."""
    if not scan.credits.may_expose(line):
        async with Deadline(scan.deadlines.store_s, "wait for a line buffer", device="storage", line=line):
            await scan.credits.wait(line)


async def _turn(scan: Scan, line: int) -> None:
    limit_s = scan.deadlines.frame_s + scan.deadlines.store_s
    async with Deadline(limit_s, "wait for the last line to be handed over", device="storage", line=line):
        await scan.handed_over.acquire()


async def sweep_past(scan: Scan, sweep: Sweep) -> None:
    """Continuous scans: run the prepared sweep; the frames come as the mirror passes, or as the camera's clock beats.

    A stop request ends the motion; the lines that were passed by then are kept.
    """
    device = scan.actuator.info.name
    actuator = as_sweeping(scan.actuator)
    limit_s = scan.deadlines.first_move_s + 2 * (actuator.run_up_s(sweep) + sweep.count * sweep.period_s)
    async with Deadline(limit_s, "sweep", device=device):
        motion = await unless_stopped(scan, actuator.sweep(sweep))
    if motion is None:
        async with Deadline(STOP_S, "stop", device=device):
            await scan.actuator.stop()
        await asyncio.sleep(scan.settling_s)
        async with Deadline(STOP_S, "disarm", device=scan.camera.info.name):
            await scan.camera.disarm()  # which ends the frames
    elif sweep.pulses and motion.pulses != sweep.count:
        raise MotionFailed(f"{motion.pulses} trigger pulses were given on the way, not {sweep.count}.", device=device)
    scan.motion_over.set()


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


async def unless_stopped(scan: Scan, motion: Coroutine[None, None, Motion]) -> Motion | None:
    """Run a motion to its end, or cancel it when the scan is asked to stop, or do not begin it at all; None then."""
    if scan.stop.is_set():
        motion.close()
        return None
    moving = asyncio.ensure_future(motion)
    stopped = asyncio.ensure_future(scan.stop.wait())
    try:
        await asyncio.wait([moving, stopped], return_when=asyncio.FIRST_COMPLETED)
        return moving.result() if moving.done() else None
    finally:
        moving.cancel()
        stopped.cancel()
        await asyncio.gather(moving, stopped, return_exceptions=True)
