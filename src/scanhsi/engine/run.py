"""Run a scan: check everything, prepare, run the three tasks, leave everything safe, report.

::

    control ──exposed──> receive ──filled──> write
       ^                                       │
       └───────────── credits ─────────────────┘

*Control* moves the mirror and exposes, *receive* takes the frames, *write* hands lines to storage. Credits, the window of lines
that may be in memory, gate the trigger. The tasks live in one `asyncio.TaskGroup`: when one fails or is cancelled, all end, and
the cleanup runs whatever happened.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from dataclasses import replace
from functools import partial
from typing import cast

from scanhsi.clock import now_ns
from scanhsi.cube.records import LineRecords
from scanhsi.cube.sink import LineSink
from scanhsi.devices import (
    Actuator,
    Camera,
    FreeRunning,
    HardwareTriggered,
    Range,
    Sighting,
    Sweep,
    Trigger,
    check_settings,
    require,
)
from scanhsi.devices.errors import DeviceTimeout, ScanFailed, ScanhsiError, UnsupportedFeature
from scanhsi.engine.cleanup import CleanupStep, clean_up, tell_nevertheless
from scanhsi.engine.control import (
    arrived,
    as_foretelling,
    as_sweeping,
    as_telling_start,
    look_ahead_and_expose,
    step_and_expose,
    sweep_past,
    unless_stopped,
)
from scanhsi.engine.deadlines import HOME_S, STOP_S, STORE_S, Deadline, deadlines
from scanhsi.engine.lookahead import Latencies
from scanhsi.engine.plan import Course, Mode
from scanhsi.engine.receive import receive_exposed, write_lines
from scanhsi.engine.report import Progress, ScanReport
from scanhsi.engine.scan import CAMERA_BUFFERS, Credits, Scan
from scanhsi.engine.summary import report
from scanhsi.engine.sweep import Places, passing_ns, receive_sweep
from scanhsi.log import get_logger

SLOWER = 1.01
"""A sweep whose line period is longer than asked by more than this factor is told of."""

_log = get_logger(__name__)


async def run_scan(
    course: Course,
    camera: Camera,
    actuator: Actuator,
    sink: LineSink,
    *,
    limits: Range | None = None,
    on_progress: Callable[[Progress], None] | None = None,
    stop: asyncio.Event | None = None,
) -> ScanReport:
    """Scan, on connected devices.

    What is not allowed is refused before anything moves, with its own error. From the first motion on, whatever goes wrong is a
    `ScanFailed`; however the scan ends, the mirror is told to stop, the camera is disarmed and the sink closed.

    Args:
        course: What to take.
        camera: Connected.
        actuator: Connected.
        sink: Where lines go; not opened yet.
        limits: Steps that the mirror may reach, where that is less than the actuator allows; run-ups of sweeps count.
        on_progress: Called at most four times a second, in the event loop.
        stop: Set it to finish the line under way and close, before the first line at once; the report then says ``stopped_early``.

    Raises:
        OutOfRange, UnsupportedFeature, CubeExists, CubeError: Refused; nothing moved, nothing was overwritten.
        ScanFailed: It began and did not end well.
    """
    course = check(course, camera, actuator, limits)
    scan = Scan(
        course=course,
        camera=camera,
        actuator=actuator,
        sink=sink,
        records=LineRecords(course.lines),
        deadlines=deadlines(camera.info, actuator.info, course.settings.exposure_s, course.stride),
        credits=Credits(camera=CAMERA_BUFFERS, storage=sink.capacity),
        stop=stop or asyncio.Event(),
        on_progress=on_progress,
    )
    scan.records.mirror_angle_rad[:] = course.angles_rad
    if course.look_ahead is not None:
        scan.latencies = Latencies(course.look_ahead)
    acquire = await _configure(scan, limits)
    await _open_sink(scan)
    failures = await _to_the_end(scan, acquire)
    if failures:
        _log.error(
            "scan failed", operation="scan", causes=[str(cause) for cause in failures], stored=scan.records.stored
        )
        stored = scan.records.stored
        raise ScanFailed(failures, stored=stored, lines=course.lines, output=sink.output) from failures[0]
    return report(scan, now_ns())


async def _open_sink(scan: Scan) -> None:
    try:
        await scan.sink.open(scan.records)
    except BaseException:
        await clean_up([_close_sink(scan)])
        raise


async def _to_the_end(scan: Scan, acquire: Callable[[], Coroutine[None, None, None]]) -> list[BaseException]:
    """Acquire and clean up; return what went wrong, first cause first.

    The acquisition is a task of its own, so that a cancellation of the scan is seen as what it is, whatever a task group that
    fails at the same time makes of it (CPython 3.11 and 3.12 leave the count of cancellations too high), and comes through.
    """
    failures: list[BaseException] = []
    work = asyncio.ensure_future(acquire())
    cancelled = False
    try:
        while not work.done():
            try:
                await asyncio.wait([work])
            except asyncio.CancelledError:
                cancelled = True
                work.cancel()
        if not work.cancelled() and (error := work.exception()) is not None:
            failures += _leaves(error)
    finally:
        failures += await clean_up(_way_out(scan))
    if cancelled:
        tell_nevertheless(failures)
        raise asyncio.CancelledError
    if work.cancelled():
        failures.append(ScanhsiError("a task of the scan was cancelled from outside."))
    return failures


def check(course: Course, camera: Camera, actuator: Actuator, limits: Range | None = None) -> Course:
    """Refuse what the devices cannot do, before anything moves; return the course with the settings filled in.

    Raises:
        OutOfRange: A camera setting or a mirror position.
        UnsupportedFeature: The mode needs an ability that a device lacks.
    """
    settings = check_settings(camera.info, course.settings)
    for place, step in (("first", course.steps[0]), ("last", course.steps[-1])):
        (limits or actuator.info.limits).check(f"step of the {place} line", int(step), device=actuator.info.name)
    if course.mode is Mode.CONTINUOUS:
        as_sweeping(actuator)
        if _sweep_trigger(camera) is Trigger.FREE_RUN:
            _frame_clock(camera)
    if course.look_ahead is not None:
        if course.mode is not Mode.STEPPED:
            raise UnsupportedFeature(f"look-ahead is for stepped scans, not for mode '{course.mode}'.")
        as_telling_start(actuator)
        as_foretelling(camera)
    return replace(course, settings=settings)


async def _configure(scan: Scan, limits: Range | None) -> Callable[[], Coroutine[None, None, None]]:
    """Apply the settings and settle what can still be refused; return what does the rest. Nothing moves."""
    async with Deadline(scan.deadlines.expose_s, "configure", device=scan.camera.info.name):
        applied = await scan.camera.configure(scan.course.settings)
        scan.course = replace(scan.course, settings=applied)
        if scan.course.mode is not Mode.CONTINUOUS:
            return partial(_acquire_stepping, scan)
        trigger = _sweep_trigger(scan.camera)
        period_s = await _line_period_s(scan, trigger)
        sweep = _sweep(scan, trigger, period_s, limits)
        if trigger is Trigger.FREE_RUN and sweep.period_s != period_s:  # both have to keep the same time
            await _frame_clock(scan.camera).set_frame_period(sweep.period_s)
    return partial(_acquire_sweeping, scan, sweep, trigger)


def _sweep(scan: Scan, trigger: Trigger, period_s: float, limits: Range | None) -> Sweep:
    """The sweep as the actuator will run it; it may be slower than asked, which is told where it matters."""
    actuator = as_sweeping(scan.actuator)
    sweep = actuator.check_sweep(
        Sweep(
            first=int(scan.course.steps[0]),
            every=scan.course.stride,
            count=scan.course.lines,
            rate_steps_s=abs(scan.course.stride) / period_s,
            pulses=trigger is Trigger.LINE,
        )
    )
    if limits is not None:
        for step in actuator.extent(sweep):
            limits.check("end of the sweep's run-up or run-out", step, device=scan.actuator.info.name)
    if sweep.period_s > SLOWER * period_s:
        _log.warning(
            "the actuator sweeps slower than asked: it knows no rate between; take more steps a line, or another period",
            device=scan.actuator.info.name,
            operation="check_sweep",
            asked_s=period_s,
            period_s=sweep.period_s,
        )
    return sweep


async def _home(scan: Scan) -> None:
    """Home where that is due. A stop request ends this, as each motion before the first line, at once: no line is under way."""
    if not scan.actuator.homed:
        async with Deadline(HOME_S, "home", device=scan.actuator.info.name):
            await unless_stopped(scan, scan.actuator.home())


async def _acquire_stepping(scan: Scan) -> None:
    await _home(scan)
    first = int(scan.course.steps[0])
    async with Deadline(scan.deadlines.first_move_s, f"move_to {first}", device=scan.actuator.info.name, line=0):
        motion = await unless_stopped(scan, scan.actuator.move_to(first))
    if motion is None:
        return
    arrived(scan, motion, 0)
    await _arm(scan, Trigger.SOFTWARE)
    control = step_and_expose if scan.latencies is None else look_ahead_and_expose
    async with asyncio.TaskGroup() as tasks:
        tasks.create_task(control(scan), name="control")
        tasks.create_task(receive_exposed(scan), name="receive")
        tasks.create_task(write_lines(scan), name="write")


async def _acquire_sweeping(scan: Scan, sweep: Sweep, trigger: Trigger) -> None:
    await _home(scan)
    actuator = as_sweeping(scan.actuator)
    async with Deadline(scan.deadlines.first_move_s, "prepare_sweep", device=scan.actuator.info.name):
        motion = await unless_stopped(scan, actuator.prepare_sweep(sweep))
    if motion is None:
        return
    await _arm(scan, trigger)
    scan.begun_ns = passing_ns(actuator.run_up_s(sweep))
    places = Places(sweep, trigger, scan.begun_ns, partial(_locate, scan))
    async with asyncio.TaskGroup() as tasks:
        tasks.create_task(sweep_past(scan, sweep), name="control")
        tasks.create_task(receive_sweep(scan, sweep, places), name="receive")
        tasks.create_task(write_lines(scan), name="write")


async def _locate(scan: Scan) -> Sighting:
    async with Deadline(STOP_S, "locate", device=scan.actuator.info.name):
        return await as_sweeping(scan.actuator).locate()


async def _line_period_s(scan: Scan, trigger: Trigger) -> float:
    """The period asked for, or the shortest at which the camera loses nothing."""
    camera = scan.camera
    if trigger is Trigger.FREE_RUN:
        shortest_s = max(scan.course.settings.exposure_s, camera.info.readout_s)
        if isinstance(camera, HardwareTriggered):  # it knows its link, too
            shortest_s = max(shortest_s, camera.shortest_trigger_period_s())
        return await _frame_clock(camera).set_frame_period(scan.course.period_s or shortest_s)
    triggered = require(camera, HardwareTriggered, "mode 'continuous'", name=camera.info.name)
    shortest_s = triggered.shortest_trigger_period_s()
    period_s = scan.course.period_s or shortest_s
    if period_s < shortest_s:
        _log.warning(
            "period below the camera's shortest: lines will be lost",
            device=camera.info.name,
            operation="configure",
            period_s=period_s,
            shortest_s=shortest_s,
        )
    return period_s


def _frame_clock(camera: Camera) -> FreeRunning:
    return require(camera, FreeRunning, "mode 'continuous'", name=camera.info.name)


def _sweep_trigger(camera: Camera) -> Trigger:
    """Position triggers where the camera takes them, its own clock else."""
    hardware = Trigger.LINE in camera.info.triggers and isinstance(camera, HardwareTriggered)
    return Trigger.LINE if hardware else Trigger.FREE_RUN


async def _arm(scan: Scan, trigger: Trigger) -> None:
    async with Deadline(scan.deadlines.expose_s, "arm", device=scan.camera.info.name):
        await scan.camera.arm(trigger, CAMERA_BUFFERS)


def _way_out(scan: Scan) -> list[CleanupStep]:
    """Mirror and camera at once, then storage, which needs neither."""
    return [
        CleanupStep("stop the mirror", scan.actuator.stop, STOP_S),
        CleanupStep("disarm the camera", scan.camera.disarm, STOP_S),
        _close_sink(scan),
    ]


def _close_sink(scan: Scan) -> CleanupStep:
    return CleanupStep("close the cube", scan.sink.close, STORE_S, after=True)


def _leaves(error: BaseException) -> list[BaseException]:
    """The exceptions of a group, scanhsi's own first, for they say most, and deadlines behind what made others wait."""
    if not isinstance(error, BaseExceptionGroup):
        return [error]
    group = cast(BaseExceptionGroup[BaseException], error)
    leaves = [leaf for part in group.exceptions for leaf in _leaves(part)]
    return sorted(leaves, key=lambda leaf: (not isinstance(leaf, ScanhsiError), isinstance(leaf, DeviceTimeout)))
