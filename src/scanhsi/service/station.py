"""The one open instrument, and everything that several people may ask of it at once. Knows nothing of the web.

One thing uses the devices at a time: a job, a motion, or the live view. A live view gives way to the others and comes back after
them. STOP goes before everything.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections import deque
from collections.abc import AsyncGenerator, Awaitable, Callable, Coroutine
from contextlib import asynccontextmanager
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final, TypeVar

from scanhsi.devices import CameraSettings, PixelFormat, ShowsScenes, check_settings
from scanhsi.devices.errors import DeviceBusy, DeviceError, PositionLost, ScanhsiError, UnsupportedFeature
from scanhsi.engine.reopening import DeviceRole
from scanhsi.imager import Imager
from scanhsi.log import get_logger
from scanhsi.service.background import Background
from scanhsi.service.downloads import Tickets
from scanhsi.service.events import Events
from scanhsi.service.folder import Folder
from scanhsi.service.jobs import Job, Jobs, plain
from scanhsi.service.lease import Lease
from scanhsi.service.models import JobModel
from scanhsi.service.preview import Preview
from scanhsi.service.problems import problem_of

T = TypeVar("T")

LOGGED: Final = 500
_log = get_logger(__name__)


@dataclass(frozen=True, slots=True)
class MirrorState:
    """Where the mirror is.

    Attributes:
        step: As the controller confirmed it; None where it is not known.
        homed: Whether steps mean angles.
        angle_rad: From the normal position, in which the mirror stands at 45 degrees; None before it was homed.
        moving: Whether it moves now.
    """

    step: int | None
    homed: bool
    angle_rad: float | None
    moving: bool


class Station:
    """An instrument for several people.

    Args:
        imager: Open.
        folder: Data folder; created where missing.
    """

    def __init__(self, imager: Imager, folder: Path) -> None:
        self.imager = imager
        self.folder = Folder(folder)
        self.started = datetime.now(UTC)
        self.events = Events()
        self.background = Background()
        self._drawing = Background(1)  # of its own: no picture waits for a download
        self.preview = Preview(self._drawing)
        self.lease = Lease(self._lease_changed)
        self.tickets = Tickets()
        self.jobs = Jobs(self._job_changed)
        self.logged: deque[dict[str, Any]] = deque(maxlen=LOGGED)
        plan = imager.default_plan()
        self.settings = CameraSettings(plan.exposure_s, plan.gain_db, plan.pixel_format)
        self.live = False
        self.moving = False
        self._devices = asyncio.Lock()
        self._operations: set[asyncio.Task[Any]] = set()
        self._live_task: asyncio.Task[None] | None = None

    @property
    def busy(self) -> str:
        """What uses the devices: ``idle``, ``live``, ``moving`` or ``job``."""
        if self.jobs.current is not None:
            return "job"
        if self.moving:
            return "moving"
        return "live" if self._live_task is not None else "idle"

    @property
    def mirror(self) -> MirrorState:
        """Where the mirror is."""
        actuator = self.imager.actuator
        if "actuator" in self.imager.lost:
            return MirrorState(None, False, None, self.moving)
        try:
            step = actuator.position
        except PositionLost:
            return MirrorState(None, False, None, self.moving)
        angle = self.imager.config.geometry.angle_rad(step) if actuator.homed else None
        return MirrorState(step, actuator.homed, angle, self.moving)

    def log(self, event: dict[str, Any]) -> None:
        """Keep an event of the log, and tell it."""
        self.logged.append(event)
        self.events.publish("log", event)

    def changed(self) -> None:
        """Tell everybody how things stand."""
        self.events.publish("state", self.state())

    def state(self) -> dict[str, Any]:
        """How things stand, plain JSON types."""
        holder, job = self.lease.holder, self.jobs.current
        scene = self.imager.camera.scene if isinstance(self.imager.camera, ShowsScenes) else None
        return plain(
            {
                "instrument": self.imager.config.name,
                "run": self.imager.run,
                "simulated": self.imager.instrument.simulated,
                "lost": self.imager.lost,
                "busy": self.busy,
                "live": self.live,
                "job": None if job is None else job.id,
                "mirror": self.mirror,
                "camera": self.settings_json(),
                "scene": scene,
                "lease": None if holder is None else asdict(holder),
                "viewers": self.preview.viewers,
                "listeners": self.events.listeners,
                "free_bytes": self.folder.free_bytes,
                "started": self.started.isoformat(timespec="seconds"),
            }
        )

    def settings_json(self) -> dict[str, Any]:
        """Settings of the camera for live views, and of plans that say nothing else."""
        settings = self.settings
        return {
            "exposure_s": settings.exposure_s,
            "gain_db": settings.gain_db,
            "pixel_format": str(settings.pixel_format),
        }

    # --- devices -------------------------------------------------------------------------------------------------

    async def set_camera(
        self, *, exposure_s: float | None = None, gain_db: float | None = None, pixel_format: PixelFormat | None = None
    ) -> None:
        """Choose settings; a live view goes on with them.

        Raises:
            OutOfRange: The camera does not allow one; nothing changed.
        """
        given = {"exposure_s": exposure_s, "gain_db": gain_db, "pixel_format": pixel_format}
        wanted = replace(self.settings, **{name: value for name, value in given.items() if value is not None})
        check_settings(self.imager.instrument.camera_info, wanted)
        self.settings = wanted
        if self.jobs.current is None:
            await self._alone("configure", self._nothing)
        self.changed()

    async def set_live(self, on: bool) -> None:
        """Switch the live view on or off. During a job it comes when that is over.

        Raises:
            DeviceError: A device was lost, and is not back.
        """
        if on and self.jobs.current is None:
            await self._have(*self.imager.lost)
        self.live = on
        if not on:
            await self._end_live()
        self._begin_live()
        self.changed()

    async def show_scene(self, scene: str) -> None:
        """Put something else before a simulated camera.

        Raises:
            UnsupportedFeature: This camera is not simulated.
            OutOfRange, DeviceBusy: As the camera does.
        """
        camera = self.imager.camera
        if not isinstance(camera, ShowsScenes):
            name = self.imager.instrument.camera_info.name
            raise UnsupportedFeature("it looks at what is before it.", device=name, operation="show")
        await self._have("camera")
        await self._alone("show", lambda: camera.show(scene))
        self.changed()

    async def home(self) -> MirrorState:
        """Find the home position.

        Raises:
            DeviceBusy, DeviceError: As the actuator does; a job is under way.
        """
        with contextlib.suppress(PositionLost):  # this is what helps
            await self._have("actuator")
        return await self._move("home", self.imager.actuator.home)

    async def go_to(self, step: int) -> MirrorState:
        """Move the mirror to a step.

        Raises:
            OutOfRange: Beyond the limits; nothing moved.
            PositionLost: It was not homed.
        """
        info = self.imager.instrument.actuator_info
        info.limits.check("step", step, device=info.name)
        await self._have("actuator")
        if not self.imager.actuator.homed:
            raise PositionLost("it was not homed.", device=info.name, operation=f"move_to {step}", hint="home it")
        return await self._move(f"move_to {step}", lambda: self.imager.actuator.move_to(step))

    async def jog(self, steps: int) -> MirrorState:
        """Move the mirror by some steps; jogs add up.

        Raises:
            OutOfRange, PositionLost: As `go_to`.
        """
        if await self._have("actuator") and not self.imager.actuator.homed:
            name = self.imager.instrument.actuator_info.name
            raise PositionLost(
                "it was lost, and does not know where it stands.",
                device=name,
                operation=f"jog {steps:+}",
                hint="home it",
            )

        async def by() -> None:
            info, actuator = self.imager.instrument.actuator_info, self.imager.actuator
            target = actuator.position + steps
            info.limits.check("step", target, device=info.name)
            await actuator.move_to(target)

        return await self._move(f"jog {steps:+}", by)

    async def reopen(self, *roles: DeviceRole) -> None:
        """Open devices anew, once each; nothing moves. See `scanhsi.Imager.reopen`.

        Args:
            roles: Which; by default those that were lost.

        Raises:
            DeviceError: As `scanhsi.Imager.reopen`; a job is under way.
        """
        if roles or self.imager.lost:
            self.live = False  # it homes the mirror: somebody is to ask for that
            await self._alone("reopen", lambda: self.imager.reopen(*roles))
        self.changed()

    async def stop(self) -> MirrorState:
        """STOP: the mirror first, then everything that would move it again. Always allowed.

        Raises:
            DeviceError: It cannot be known that the mirror stands still.
        """
        self.live = False
        job = self.jobs.current
        stopping = asyncio.ensure_future(self.imager.actuator.stop())
        tasks = [*self._operations, *([job.task] if job is not None and job.task is not None else [])]
        for task in tasks:
            task.cancel()
        try:
            await asyncio.shield(stopping)
        except DeviceError as error:
            self._note_lost(error)
            raise
        finally:
            await self._end_live()
            await asyncio.gather(*tasks, return_exceptions=True)
            self.log(_logged("warning", "STOP"))
            self.changed()
        return self.mirror

    # --- jobs ----------------------------------------------------------------------------------------------------

    def begin(self, job: Job, work: Callable[[Job], Awaitable[dict[str, Any]]]) -> Job:
        """Start a job, which has the devices for itself.

        Raises:
            DeviceBusy: Another one is under way, or the mirror moves.
        """
        self._refuse_if_busy(job.kind)

        async def alone(job: Job) -> dict[str, Any]:
            async with self._devices:
                await self._end_live()
                await self.imager.reopen()
                return await work(job)

        return self.jobs.start(job, alone)

    def _refuse_if_busy(self, operation: str) -> None:
        job = self.jobs.current
        if job is not None:
            raise DeviceBusy(
                f"{job.title} is under way.",
                device=self.imager.config.name,
                operation=operation,
                hint=f"wait, or POST /api/v1/jobs/{job.id}/cancel",
            )

    # --- inside --------------------------------------------------------------------------------------------------

    async def _have(self, *roles: DeviceRole) -> bool:
        """Open these devices anew if they were lost, on somebody's command; return whether any was."""
        lost: list[DeviceRole] = [role for role in self.imager.lost if role in roles]
        if lost:
            await self._alone("reopen", lambda: self.imager.reopen(*lost))
        return bool(lost)

    def _note_lost(self, error: DeviceError) -> None:
        self.imager.note_lost(error)
        if self.imager.lost:
            self.live = False
            self.changed()

    async def _nothing(self) -> None:
        """A live view begins anew, with the settings as they are now."""

    async def _move(self, operation: str, move: Callable[[], Coroutine[Any, Any, Any]]) -> MirrorState:
        async def moving() -> None:
            self.moving = True
            self.changed()
            try:
                await move()
            except asyncio.CancelledError:
                await self.imager.actuator.stop()
                raise
            finally:
                self.moving = False
                self.changed()

        await self._alone(operation, moving)
        return self.mirror

    async def _alone(self, operation: str, work: Callable[[], Coroutine[Any, Any, T]]) -> T:
        """Run something with the devices for itself, in a task that goes on when whoever asked for it hangs up."""
        self._refuse_if_busy(operation)

        async def locked() -> T:
            async with self._devices:
                self._refuse_if_busy(operation)
                await self._end_live()
                try:
                    return await work()
                except DeviceError as error:
                    self._note_lost(error)
                    raise
                finally:
                    self._begin_live()

        task = asyncio.get_running_loop().create_task(locked(), name=operation)
        self._operations.add(task)
        task.add_done_callback(self._operations.discard)
        try:
            return await asyncio.shield(task)
        except asyncio.CancelledError:
            if task.cancelled():
                raise DeviceBusy("it was stopped.", device=self.imager.config.name, operation=operation) from None
            raise

    def _begin_live(self) -> None:
        if self.live and self._live_task is None and self.jobs.current is None:
            if self.imager.lost:  # it would home a mirror that was lost: not without somebody's asking for it
                self.live = False
                return
            self._live_task = asyncio.get_running_loop().create_task(self._look(), name="live")

    async def _end_live(self) -> None:
        task, self._live_task = self._live_task, None
        if task is not None:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)

    async def _look(self) -> None:
        settings, instrument = self.settings, self.imager.instrument
        roi = check_settings(
            instrument.camera_info,
            replace(settings, roi=self.imager.config.roi.roi if self.imager.config.roi else None),
        ).roi
        assert roi is not None, "check_settings fills the ROI in"
        self.preview.begin("live", shape=roi.shape, bits=settings.pixel_format.bits, exposure_s=settings.exposure_s)
        try:
            await self.imager.live(
                self.preview.watch,
                exposure_s=settings.exposure_s,
                gain_db=settings.gain_db,
                pixel_format=settings.pixel_format,
            )
        except ScanhsiError as error:
            self.live = False
            self._live_task = None
            self.log(_logged("error", f"the live view ended: {error}", **problem_of(error)))
            self.changed()

    def _lease_changed(self) -> None:
        holder = self.lease.holder
        self.events.publish("lease", {"holder": None if holder is None else holder.name})
        self.changed()

    def _job_changed(self, job: Job) -> None:
        self.events.publish("job", JobModel.of(job).model_dump(mode="json"))
        if job.over:
            asyncio.get_running_loop().call_soon(self._begin_live)
        self.changed()

    async def close(self) -> None:
        """End everything; the instrument is safe afterwards."""
        self.live = False
        job = self.jobs.current
        tasks = [*self._operations, *([job.task] if job is not None and job.task is not None else [])]
        for task in tasks:
            task.cancel()
        await self._end_live()
        await asyncio.gather(*tasks, return_exceptions=True)
        self.lease.close()
        self.background.close()
        self._drawing.close()


def _logged(level: str, event: str, **more: Any) -> dict[str, Any]:
    return {"time": datetime.now(UTC).isoformat(timespec="milliseconds"), "level": level, "event": event, **more}


@asynccontextmanager
async def open_station(imager: Imager, folder: Path) -> AsyncGenerator[Station]:
    """A station, closed on leaving: what is under way is cancelled, which leaves valid cubes and a mirror at rest."""
    station = Station(imager, folder)
    try:
        yield station
    finally:
        with contextlib.suppress(ScanhsiError):
            await station.close()
