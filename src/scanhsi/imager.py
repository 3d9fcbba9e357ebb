"""The Python interface: open an instrument, scan with it."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Callable, Generator
from contextlib import asynccontextmanager, contextmanager, nullcontext
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any
from uuid import uuid4

import numpy as np
from pydantic import ValidationError
from structlog.contextvars import bind_contextvars, unbind_contextvars

from scanhsi import clock
from scanhsi.clock import Granted, RealTime
from scanhsi.cube import CubeSpec, CubeWriter, DiscardSink
from scanhsi.cube.places import destination_of
from scanhsi.cube.watched import Watch
from scanhsi.devices import Actuator, Camera, CameraSettings, Light, PixelFormat, sensor_temperature_c
from scanhsi.devices.errors import ConfigError, DeviceBusy, ScanhsiError
from scanhsi.engine import Course, Mode, Progress, ScanControl, ScanPlan, ScanReport, run_scan
from scanhsi.engine.lost import LostDevices
from scanhsi.engine.reopening import DeviceRole
from scanhsi.engine.resume import Begun, begun
from scanhsi.instrument import Instrument, InstrumentConfig, load_instrument
from scanhsi.instrument.problems import problems_of
from scanhsi.output import cube_spec, new_writer, slowed, watched

if TYPE_CHECKING:
    from scanhsi.characterise.calibrator import Calibrator
    from scanhsi.processing.live import LiveProcessing

_NO_OPTIONS = RealTime()
_LIVE_LINES = 4096
"""Frames of one acquisition of a live view; then the next one begins."""


def default_plan(config: InstrumentConfig, **overrides: Any) -> ScanPlan:
    """The plan of an instrument file's ``[scan]`` table, with some fields set otherwise.

    Raises:
        ConfigError: A field is wrong; lists every problem.
    """
    written = {key: value for key, value in config.scan.model_dump().items() if value is not None}
    for key, value in overrides.items():
        field = next((name for name, info in ScanPlan.model_fields.items() if info.alias == key), key)
        written.pop(field, None)
        written[key] = value
    if written.get("mode") != Mode.CONTINUOUS and not {"period", "period_s"} & overrides.keys():
        written.pop("period_s", None)  # the file's period is for its continuous scans
    if written.get("mode", Mode.STEPPED) != Mode.STEPPED and "look_ahead" not in overrides:
        written.pop("look_ahead", None)
    try:
        return ScanPlan.model_validate(written)
    except ValidationError as error:
        raise ConfigError("the scan plan is wrong:", problems_of(error, ScanPlan)) from error


@asynccontextmanager
async def open_instrument(
    source: str | Path | InstrumentConfig, *, seed: int | None = None, delays: str | Path | None = None
) -> AsyncGenerator[Imager]:
    """Connect the devices of an instrument; close them again on leaving.

    Args:
        source: Name of a shipped instrument (``"sensors2019"``), path of an instrument file, or a configuration.
        seed: For simulated devices: draw delays and noise from this seed instead of the one in the file.
        delays: For simulated devices: a delay profile to spend instead of the one in the file, by path (``*.json``) or name. A
            recorded one is replayed, see `scanhsi.timing.replay`.

    Raises:
        ConfigError: The instrument file is wrong; lists every problem.
        DeviceError: A device cannot be connected.
    """
    config = source if isinstance(source, InstrumentConfig) else load_instrument(source)
    if seed is not None:
        config = config.with_seed(seed)
    if delays is not None:
        config = config.with_delays(str(delays))
    run = uuid4().hex[:12]
    bind_contextvars(run=run)
    try:
        async with Instrument.open(config) as instrument:
            yield Imager(instrument, run)
    finally:
        unbind_contextvars("run")


class Imager:
    """An open instrument that scans; made by `open_instrument`.

    Attributes:
        instrument: Its configuration and devices.
        run: Identifies this opening in logs and cubes.
    """

    def __init__(self, instrument: Instrument, run: str) -> None:
        self.instrument = instrument
        self.run = run
        self._scanning = False
        self._lost = LostDevices(instrument)

    @property
    def config(self) -> InstrumentConfig:
        """The instrument file."""
        return self.instrument.config

    @property
    def camera(self) -> Camera:
        """The camera, for use between scans."""
        return self.instrument.camera

    @property
    def actuator(self) -> Actuator:
        """The actuator, for use between scans."""
        return self.instrument.actuator

    @property
    def calibrate(self) -> Calibrator:
        """Protocols that characterise the instrument: ``await hsi.calibrate.dark("dark.nc")``."""
        from scanhsi.characterise.calibrator import Calibrator  # brings all protocols and half of scipy

        return Calibrator(self)

    def default_plan(self, **overrides: Any) -> ScanPlan:
        """The plan of the instrument file's ``[scan]`` table, with some fields set otherwise; see `default_plan`."""
        return default_plan(self.config, **overrides)

    def course(self, plan: ScanPlan) -> Course:
        """What a plan comes to on this instrument.

        Raises:
            OutOfRange: A setting or a mirror position is not allowed here; nothing moved.
        """
        geometry = self.config.geometry
        steps = plan.steps(geometry.normal_step)
        asked = CameraSettings(
            exposure_s=plan.exposure_s,
            gain_db=plan.gain_db,
            pixel_format=plan.pixel_format,
            roi=self.config.roi.roi if self.config.roi else None,
        )
        settings = self.instrument.check(asked, (int(steps[0]), int(steps[-1])))
        angles = np.array([geometry.angle_rad(int(step)) for step in steps])
        return Course(plan.mode, settings, steps, angles, plan.period_s, plan.look_ahead, plan.recovery)

    async def scan(
        self,
        plan: ScanPlan,
        output: str | Path | None,
        *,
        on_progress: Callable[[Progress], None] | None = None,
        stop: asyncio.Event | None = None,
        control: ScanControl | None = None,
        real_time: RealTime = _NO_OPTIONS,
        target: str | None = None,
        spool: str | Path | None = None,
        watch: Watch | None = None,
        process: LiveProcessing | None = None,
    ) -> ScanReport:
        """Scan.

        Args:
            plan: What to scan.
            output: Path of the cube to create, or its URL in an object store (``s3://bucket/cube.zarr``); it must not exist. None
                discards the lines.
            on_progress: Called at most four times a second, in the event loop.
            stop: Set it to finish the line under way and close the cube.
            control: Instead of ``stop``: pauses the scan, too, and lets it go on.
            real_time: Options against lateness, for the time of the scan. What was granted is in the report and in the cube.
            target: What is before the instrument; kept in the cube.
            spool: For URLs: local folder that what is written waits in until the server has it. A line is stored once it is there,
                and goes on its way in the background, also when the scan is over: `scanhsi.drain` waits for that, or sends later
                what a process that ended left.
            watch: Shown each line on its way to storage, also where lines are discarded; see `scanhsi.cube.watched`.
            process: Another cube to be made of the raw one while it is scanned, by another process, which costs the scan no line.
                This returns when that is done, too; what became of it is in the report.

        Raises:
            OutOfRange, UnsupportedFeature, CubeExists, CalibrationError: Refused; nothing moved, nothing was overwritten.
            DeviceBusy: A scan of this instrument is under way.
            ScanFailed: It began and did not end well; what was stored is safe and opens as a shorter cube.
        """
        async with self._one_scan():
            course = self.course(plan)
            limits = self.instrument.actuator_info.limits
            with clock.real_time(real_time) as granted:
                place = None if output is None else destination_of(output, spool=spool)
                spec = None if place is None else self._spec(course, plan, granted, target)
                if spec is not None and (warmth := await sensor_temperature_c(self.camera)) is not None:
                    spec = replace(spec, attributes={**spec.attributes, "sensor_temperature_c": warmth})
                sink = DiscardSink() if place is None or spec is None else new_writer(self.config, place, spec)
                sink = slowed(sink, self.config, plan)
                async with nullcontext() if process is None else process.beside(spec, output) as processing:
                    report = await run_scan(
                        course,
                        self.camera,
                        self.actuator,
                        sink if watch is None else watched(sink, watch, course),
                        limits=limits,
                        on_progress=on_progress,
                        stop=stop,
                        control=control,
                        light=await self._light(target),
                    )
                    processed = None if processing is None else await processing.finish()
                return replace(report, real_time=granted, processed=processed)

    async def resume(
        self,
        cube: str | Path,
        plan: ScanPlan | None = None,
        *,
        on_progress: Callable[[Progress], None] | None = None,
        control: ScanControl | None = None,
        real_time: RealTime = _NO_OPTIONS,
        spool: str | Path | None = None,
        watch: Watch | None = None,
    ) -> ScanReport:
        """Finish a cube that was interrupted: killed, failed, or stopped early. Only lines that are not stored are taken.

        Args:
            cube: Path or URL.
            plan: Its plan, by default as the cube tells it; what to do about faults may be another.
            on_progress: As for `scan`.
            control: As for `scan`.
            real_time: As for `scan`.
            spool: As for `scan`.
            watch: As for `scan`.

        Raises:
            NotACube, CubeError: There is nothing to be resumed.
            ConfigError: Plan, instrument file or devices are not those that the cube was begun with; lists every difference.
            OutOfRange, UnsupportedFeature: Refused; nothing moved.
            DeviceBusy: A scan of this instrument is under way.
            ScanFailed: As `scan`; the cube can be resumed again.
        """
        async with self._one_scan():
            before = begun(destination_of(cube))  # what is waiting in a spool changes nothing of that
            plan = plan or before.plan
            self._check_the_same(before, plan)
            course = self.course(plan)
            with clock.real_time(real_time) as granted:
                spec = self._spec(course, plan, granted, None)
                attributes = {**spec.attributes, **before.of_the_scan}
                durability = self.config.storage.durability
                place = destination_of(cube, spool=spool)
                writer = CubeWriter.resume(place, replace(spec, attributes=attributes), durability=durability)
                sink = slowed(writer, self.config, plan)
                report = await run_scan(
                    course,
                    self.camera,
                    self.actuator,
                    sink if watch is None else watched(sink, watch, course),
                    limits=self.instrument.actuator_info.limits,
                    on_progress=on_progress,
                    control=control,
                    first=writer.next_line,
                    light=await self._light(before.attributes.get("target")),
                )
                return replace(report, real_time=granted)

    def _check_the_same(self, before: Begun, plan: ScanPlan) -> None:
        problems = before.differences(self.config, plan, self.instrument.describe())
        if not self.instrument.actuator_info.finds_home:
            problems.append(
                "the mirror's drive cannot find its home by itself: nobody knows that its steps still mean the same"
            )
        if problems:
            raise ConfigError(
                f"{before.name} cannot be gone on with:", problems, hint="the instrument as it was, or a new cube."
            )

    async def live(
        self,
        watch: Watch,
        *,
        exposure_s: float | None = None,
        gain_db: float | None = None,
        pixel_format: PixelFormat | None = None,
        step: int | None = None,
        period_s: float = 1 / 15,
    ) -> None:
        """Show what is before the instrument, with the mirror at rest, until cancelled; nothing is stored.

        Args:
            watch: Shown each frame; see `scanhsi.cube.watched`.
            exposure_s: Of a frame; the instrument file's by default, as the next two.
            gain_db: Of the camera.
            pixel_format: On the link.
            step: Where the mirror looks; where it stands by default, straight ahead before it was homed.
            period_s: Least time from frame to frame.

        Raises:
            OutOfRange, DeviceBusy, ScanFailed: As `scan`.
        """
        if step is None:
            step = self.actuator.position if self.actuator.homed else self.config.geometry.normal_step
        given = {"exposure_s": exposure_s, "gain_db": gain_db, "pixel_format": pixel_format}
        chosen = {name: value for name, value in given.items() if value is not None}
        plan = self.default_plan(mode="stepped", look_ahead=None, lines=_LIVE_LINES, step=0, start=step, **chosen)
        course = self.course(plan)
        while True:
            async with self._one_scan():
                sink = watched(DiscardSink(capacity=1), watch, course, period_s)  # one buffer: no frame is shown late
                await run_scan(
                    course,
                    self.camera,
                    self.actuator,
                    sink,
                    limits=self.instrument.actuator_info.limits,
                    light=self.instrument.light,
                )

    @property
    def lost(self) -> dict[DeviceRole, str]:
        """Devices that were lost, and what happened to each: they are opened anew before they are used again."""
        return self._lost.why

    def note_lost(self, error: BaseException) -> None:
        """See from an error of a device that was used directly whether it is lost. Scans do so by themselves."""
        self._lost.note(error)

    async def reopen(self, *devices: DeviceRole) -> None:
        """Open devices anew, once each: close, connect, have the mirror stand and the light off. Nothing moves.

        `scan`, `resume`, `live` and calibrations do so by themselves with what is `lost`, and then set the camera up and home the
        mirror as they always do. It takes a call before ``hsi.actuator`` or ``hsi.camera`` is used directly, or for a device that
        does not seem well: see ``hsi.actuator.homed`` then before you move the mirror, and configure the camera.

        Args:
            devices: ``"camera"``, ``"actuator"``, ``"light"``; those in `lost` by default.

        Raises:
            DeviceNotFound: Nothing answers, or another device than before.
            DeviceError: It cannot be opened, or did not confirm that it is at rest. It stays `lost`, and can be tried again.
            PositionLost: It is open, but nobody knows where the mirror stands, and this drive cannot find its home by itself. Told
                once: the next motion takes the mirror to stand where the controller believes.
            DeviceBusy: A scan is under way.
        """
        with self._alone("reopen"):
            await self._lost.reopen(devices or None)

    async def _light(self, target: object) -> Light | None:
        """What is switched on for a scan: a dark reference is taken without."""
        light = self.instrument.light
        if light is None or target != "dark":
            return light
        await light.off()  # a program that died may have left it on
        return None

    @contextmanager
    def _alone(self, operation: str) -> Generator[None]:
        if self._scanning:
            raise DeviceBusy("a scan is under way.", device=self.config.name, operation=operation)
        self._scanning = True
        try:
            yield
        finally:
            self._scanning = False

    @asynccontextmanager
    async def _one_scan(self) -> AsyncGenerator[None]:
        """The devices for one scan, those open again that were lost before."""
        with self._alone("scan"):
            await self._lost.look()
            await self._lost.reopen()
            try:
                yield
            except ScanhsiError as error:
                self._lost.note(error)
                raise

    def _spec(self, course: Course, plan: ScanPlan, granted: Granted, target: str | None) -> CubeSpec:
        session = {"run": self.run, "real_time": asdict(granted), **({} if target is None else {"target": target})}
        return cube_spec(self.instrument, course, plan, session)
