"""Run a scan: check everything, prepare, take it leg by leg, leave everything safe, report.

::

    control ──exposed──> receive ──filled──> write
       ^                                       │
       └───────────── credits ─────────────────┘

*Control* moves the mirror and exposes, *receive* takes the frames, *write* hands lines to storage. Credits, the window of lines
that may be in memory, gate the trigger. Control and receive are made anew for each leg (`scanhsi.engine.legs`), write lives as long
as the scan. When a task fails or is cancelled, all end, and the cleanup runs whatever happened.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import replace
from functools import partial

from scanhsi.clock import now_ns
from scanhsi.cube.records import LineRecords
from scanhsi.cube.sink import LineSink
from scanhsi.devices import (
    Actuator,
    Camera,
    FreeRunning,
    HardwareTriggered,
    Light,
    OverlapsReadout,
    Range,
    Trigger,
    check_settings,
    require,
)
from scanhsi.devices.errors import ScanFailed, UnsupportedFeature
from scanhsi.engine.cleanup import CleanupStep, clean_up, tell_nevertheless
from scanhsi.engine.control import as_foretelling, as_sweeping, as_telling_start
from scanhsi.engine.deadlines import STORE_S, Part, Watch, deadlines
from scanhsi.engine.legs import TakeLeg, acquire, finish, plan_sweep, take_steps, take_sweep
from scanhsi.engine.lookahead import Latencies
from scanhsi.engine.plan import Course, Mode
from scanhsi.engine.recovery import lost_devices
from scanhsi.engine.report import Progress, ScanReport
from scanhsi.engine.safety import leave_safe
from scanhsi.engine.scan import CAMERA_BUFFERS, Credits, Faults, Scan
from scanhsi.engine.steering import ScanControl
from scanhsi.engine.summary import report
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
    control: ScanControl | None = None,
    first: int = 0,
    light: Light | None = None,
) -> ScanReport:
    """Scan, on connected devices.

    What is not allowed is refused before anything moves, with its own error. From the first motion on, whatever goes wrong is a
    `ScanFailed`; however the scan ends, the mirror is told to stop, the camera is disarmed, the light switched off and the sink
    closed.

    Args:
        course: What to take.
        camera: Connected. Closed and connected anew where the course says so and it is lost.
        actuator: As the camera.
        sink: Where lines go; not opened yet.
        limits: Steps that the mirror may reach, where that is less than the actuator allows; run-ups of sweeps count.
        on_progress: Called at most four times a second, in the event loop.
        stop: Set it to finish the line under way and close, before the first line at once; the report then says ``stopped_early``.
        control: Instead of ``stop``: pauses, too.
        first: First line to be taken; those before it are in the sink already.
        light: Connected. Switched on before the first line, and off on every way out.

    Raises:
        OutOfRange, UnsupportedFeature, CubeExists, CubeError: Refused; nothing moved, nothing was overwritten.
        ScanFailed: It began and did not end well.
    """
    if control is None:
        control = ScanControl() if stop is None else ScanControl(stop)
    elif stop is not None:
        raise ValueError("give either stop or control")
    try:
        course = check(course, camera, actuator, limits)
        scan = _new_scan(course, camera, actuator, sink, first)
        scan.control, scan.on_progress = control, on_progress
        scan.limits = limits or scan.limits
        _use_light(scan, light)
        take_leg = await _configure(scan)
        await _open_sink(scan)
    except BaseException:
        await clean_up([_close_sink(sink)])  # one that goes on with a cube holds its lock already
        raise
    failures = await _to_the_end(scan, take_leg)
    if failures:
        _log.error(
            "scan failed", operation="scan", causes=[str(cause) for cause in failures], stored=scan.records.stored
        )
        stored = scan.records.stored
        lost = lost_devices(scan, failures)
        raise ScanFailed(failures, stored=stored, lines=course.lines, output=sink.output, lost=lost) from failures[0]
    return report(scan, now_ns())


def _new_scan(course: Course, camera: Camera, actuator: Actuator, sink: LineSink, first: int) -> Scan:
    return Scan(
        course=course,
        camera=camera,
        actuator=actuator,
        sink=sink,
        camera_info=camera.info,
        actuator_info=actuator.info,
        limits=actuator.info.limits,
        records=LineRecords(course.lines),
        deadlines=deadlines(camera.info, actuator.info, course.settings.exposure_s, course.stride),
        watch=Watch({Part.CAMERA: camera.info.name, Part.ACTUATOR: actuator.info.name, Part.STORAGE: "storage"}),
        credits=Credits(CAMERA_BUFFERS, lambda: sink.capacity, first),
        faults=Faults(course.recovery),
        first=first,
        taken=first,
        latencies=None if course.look_ahead is None else Latencies(course.look_ahead),
    )


def _use_light(scan: Scan, light: Light | None) -> None:
    if light is not None:
        scan.light = light
        scan.watch.names[Part.LIGHT] = light.info.name


async def _open_sink(scan: Scan) -> None:
    await scan.sink.open(scan.records)
    scan.records.mirror_angle_rad[scan.first :] = scan.course.angles_rad[scan.first :]
    scan.earlier_incidents = len(scan.records.incidents)


async def _to_the_end(scan: Scan, take_leg: TakeLeg) -> list[BaseException]:
    """Acquire and clean up; return what went wrong, first cause first."""
    failures, cancelled = await finish(acquire(scan, take_leg))
    scan.going_on("the scan ended")
    failures += await clean_up([*leave_safe(scan), _close_sink(scan.sink)])
    if cancelled:
        tell_nevertheless(failures)
        raise asyncio.CancelledError
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


async def _configure(scan: Scan) -> TakeLeg:
    """Apply the settings and settle what can still be refused; return what takes a leg. Nothing moves."""
    camera = scan.camera
    async with scan.watch(Part.CAMERA, scan.deadlines.expose_s, "configure"):
        applied = await camera.configure(scan.course.settings)
        scan.course = replace(scan.course, settings=applied)
        scan.dead_time_s = camera.dead_time_s() if isinstance(camera, OverlapsReadout) else None
        if scan.course.mode is not Mode.CONTINUOUS or scan.over:
            return partial(take_steps, scan)
        trigger = _sweep_trigger(camera)
        period_s = await _line_period_s(scan, trigger)
        sweep = plan_sweep(scan, trigger, period_s)
        _tell_if_slower(scan, sweep.period_s, period_s)
        if trigger is Trigger.FREE_RUN:
            scan.frame_period_s = period_s
            if sweep.period_s != period_s:  # both have to keep the same time
                scan.frame_period_s = await _frame_clock(camera).set_frame_period(sweep.period_s)
    return partial(take_sweep, scan, trigger, period_s)


def _tell_if_slower(scan: Scan, period_s: float, asked_s: float) -> None:
    if period_s > SLOWER * asked_s:
        _log.warning(
            "the actuator sweeps slower than asked: it knows no rate between; take more steps a line, or another period",
            device=scan.actuator_info.name,
            operation="check_sweep",
            asked_s=asked_s,
            period_s=period_s,
        )


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


def _close_sink(sink: LineSink) -> CleanupStep:
    return CleanupStep("close the cube", sink.close, STORE_S, after=True, device="storage")
