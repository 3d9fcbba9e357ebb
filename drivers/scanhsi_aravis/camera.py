"""`AravisCamera`: the camera contract over a blocking `Session`, which runs on one thread of its own."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import TypeVar, TypeVarTuple, Unpack

import structlog

from scanhsi.clock import sleep_until_ns
from scanhsi.devices.camera import CameraInfo, CameraSettings, Exposure, Trigger, check_settings
from scanhsi.devices.errors import (
    DeviceBusy,
    DeviceError,
    DeviceLost,
    DeviceTimeout,
    OutOfRange,
    UnsupportedFeature,
)
from scanhsi.devices.frames import Frame, FrameStream, Pixels
from scanhsi.devices.pixels import PixelFormat, unpack
from scanhsi_aravis.armed import Armed, Times
from scanhsi_aravis.errors import HINTS
from scanhsi_aravis.options import AravisOptions
from scanhsi_aravis.order import Pending
from scanhsi_aravis.session import Session
from scanhsi_aravis.stream import Arrival

T = TypeVar("T")
Ts = TypeVarTuple("Ts")

CONTROL_RETRY_S = 4.0
"""How long ``connect`` tries to get control: a camera lets go of a program that died after 3 s without heartbeat."""
ANSWER_S = 5.0
"""Longest time that Aravis asks a camera that does not answer: five times 0.5 s, after a heartbeat that did the same."""

log = structlog.get_logger(__name__)


class AravisCamera:
    """A GigE Vision camera.

    A camera that vanishes is noticed within `lost_after_s` of the last expected frame; one that is being told something, within
    `ANSWER_S`. The end of an exposure is timed: the camera's confirmation of the trigger + exposure + ``exposure_margin_s``.

    Args:
        options: What the instrument file says.
    """

    def __init__(self, options: AravisOptions) -> None:
        self._options = options
        self._name = f"camera aravis {options.address}"
        self._session = Session(options, self._name)
        self._control: ThreadPoolExecutor | None = None
        self._worker: ThreadPoolExecutor | None = None
        self._info: CameraInfo | None = None
        self._settings: CameraSettings | None = None
        self._readout_s = 0.0
        self._period_s: float | None = None
        self._armed: Armed | None = None
        self._watcher: asyncio.Task[None] | None = None
        self._lost: DeviceError | None = None

    # -- opening and closing

    @property
    def info(self) -> CameraInfo:
        """What the camera is and allows."""
        if self._info is None:
            raise DeviceError("not connected.", device=self._name, operation="info")
        return self._info

    async def connect(self) -> None:
        """Open the camera and take control of it; waits `CONTROL_RETRY_S` for one that another program controls."""
        if self._control is not None:
            raise DeviceBusy("connected already.", device=self._name, operation="connect")
        self._control = ThreadPoolExecutor(1, "aravis-control")
        self._worker = ThreadPoolExecutor(1, "aravis-unpack")
        loop = asyncio.get_running_loop()
        started_s = loop.time()
        try:
            await self._call(self._session.open, partial(_post, loop, self._control_lost))
            await self._take_control(started_s)
            info, self._settings = await self._call(self._session.describe)
        except DeviceError:
            await self.close()
            raise
        self._info = replace(info, simulated=is_simulated(info.vendor, info.model))
        self._readout_s = info.readout_s

    async def close(self) -> None:
        """Disarm, give up control, free everything but what a consumer still views."""
        with suppress(DeviceError):
            await self.disarm()
        if self._control is None or self._worker is None:
            return
        await self._run(partial(self._session.close, lost=self._lost is not None))
        self._control.shutdown()
        self._worker.shutdown()
        self._control = self._worker = None
        self._info = self._settings = self._lost = self._period_s = None

    async def _take_control(self, started_s: float) -> None:
        while not await self._call(self._session.take_control):
            waited_s = asyncio.get_running_loop().time() - started_s
            if waited_s >= CONTROL_RETRY_S:
                raise DeviceBusy(
                    "another program controls it.",
                    device=self._name,
                    operation="connect",
                    waited_s=waited_s,
                    hint=HINTS[DeviceBusy],
                )
            await asyncio.sleep(0.2)

    # -- settings

    async def configure(self, settings: CameraSettings) -> CameraSettings:
        """Apply settings; exposure and gain come back as the camera rounded them."""
        wanted = check_settings(self.info, settings)
        self._refuse_while_armed("configure")
        self._settings, self._readout_s = await self._call(self._session.configure, wanted)
        return self._settings

    async def set_frame_period(self, period_s: float) -> float:
        """Set the time between exposures of free run, s."""
        self._refuse_while_armed("set frame period")
        self._check_period(period_s)
        self._period_s = await self._call(self._session.set_frame_period, period_s)
        return self._period_s

    def shortest_trigger_period_s(self) -> float:
        """Exposure and dead time, s."""
        return self._configured("timing").exposure_s + self.dead_time_s()

    def dead_time_s(self) -> float:
        """What is left of read-out when the next exposure may begin, s; all of it for a sensor that cannot overlap."""
        hidden_s = self._configured("timing").exposure_s if self._options.overlaps_readout else 0.0
        return max(self._readout_s - hidden_s, 0.0)

    async def temperature_c(self) -> float | None:
        """How warm the camera is, where its ``DeviceTemperatureSelector`` points; armed or not."""
        return await self._call(self._session.temperature_c)

    @property
    def lost_after_s(self) -> float:
        """Longest time from the moment a frame should have come until a dead camera raises `DeviceLost`, s."""
        return self._silence_s() + ANSWER_S

    def _silence_s(self) -> float:
        return self._options.frame_timeout_s + max(self._readout_s, 3 * (self._period_s or 0.0))

    def _check_period(self, period_s: float) -> None:
        shortest_s = self.shortest_trigger_period_s()
        if not period_s >= shortest_s * (1 - 1e-9):
            raise OutOfRange(
                f"frame period {period_s:g} s is not allowed; exposure and read-out take {shortest_s:g} s.",
                device=self._name,
                operation="set frame period",
            )

    # -- frames

    async def arm(self, trigger: Trigger, buffers: int) -> None:
        """Make the ring and the stream, and start; a free run without a period runs as fast as the camera can."""
        settings = self._configured("arm")
        self._refuse_while_armed("arm")
        if buffers < 1:
            raise OutOfRange(f"{buffers} buffers are not enough.", device=self._name, operation="arm")
        if trigger not in self.info.triggers:
            known = ", ".join(sorted(self.info.triggers))
            raise UnsupportedFeature(
                f"the camera has no trigger {trigger} (it has: {known}; hardware input {self._options.trigger_line}).",
                device=self._name,
                operation="arm",
            )
        if trigger is Trigger.FREE_RUN:
            await self.set_frame_period(self._period_s or self.shortest_trigger_period_s())
        armed = Armed(trigger, settings, self._times(settings))
        deliver = partial(_post_arrival, asyncio.get_running_loop(), armed)
        self._armed = armed  # before anything can go wrong: disarm undoes it
        try:
            armed.ring = await self._call(self._session.start, trigger, buffers, deliver)
        except DeviceError:
            await self.disarm()
            raise
        self._watcher = asyncio.create_task(self._watch(armed), name=f"{self._name}: watchdog")

    async def disarm(self) -> None:
        """Stop exposing; exposures whose frame has not come end as gaps."""
        armed = self._armed
        if armed is None:
            return
        try:
            if self._watcher is not None:
                self._watcher.cancel()
                await asyncio.wait([self._watcher])
            await self._run(partial(self._session.stop, lost=self._lost is not None))
        except DeviceLost as error:
            self._fail(error)
            raise
        finally:
            armed.finish()
        self._armed = self._watcher = None

    async def expose(self) -> Exposure:
        """Trigger one exposure; return at the end of exposure (timed)."""
        return await self.expose_foretold(lambda end_ns: None)

    async def expose_foretold(self, foretold: Callable[[int], None]) -> Exposure:
        """Trigger one exposure, tell when it will end once the camera has confirmed it, and return then."""
        armed = self._armed_for("expose")
        if armed.trigger is not Trigger.SOFTWARE:
            raise DeviceError(f"armed for the trigger {armed.trigger}.", device=self._name, operation="expose")
        await sleep_until_ns(await armed.may_trigger(self._options.triggers_in_flight))
        pending = Pending()
        loop = asyncio.get_running_loop()

        # Told from the control thread, so that the count is right even when this call is cancelled half-way.
        def sent(at_ns: int) -> None:
            _post(loop, armed.triggered, pending, at_ns)

        def confirmed(at_ns: int) -> None:
            _post(loop, armed.trigger_confirmed, pending, at_ns)

        def refused() -> None:
            _post(loop, armed.trigger_refused, pending)

        await self._call(self._session.fire, sent, confirmed, refused)
        foretold(pending.end_ns)
        await sleep_until_ns(pending.end_ns)
        return Exposure(pending.index, pending.sent_ns, pending.sent_ns, pending.end_ns, timed=True)

    def frames(self) -> FrameStream:
        """Frames and gaps since ``arm()``."""
        return self._armed_for("frames").channel

    async def unpack(self, frame: Frame, out: Pixels | None) -> None:
        """Copy or unpack; when cancelled, ends before ``out`` may be used again.

        A whole sensor of Mono12Packed takes up to 5 ms, so it is unpacked in a worker thread and does not delay the end of an
        exposure. The other formats are copied in 0.1 to 0.3 ms, no more than the way to a worker and back costs.
        """
        if out is None or frame.payload is None:
            return
        if frame.pixel_format is not PixelFormat.MONO12_PACKED:
            unpack(frame.payload, frame.pixel_format, out)
            return
        job = asyncio.get_running_loop().run_in_executor(self._worker, unpack, frame.payload, frame.pixel_format, out)
        try:
            await asyncio.shield(job)
        except asyncio.CancelledError:
            await asyncio.wait([job])
            raise

    # -- the watchdog

    async def _watch(self, armed: Armed) -> None:
        while armed.error is None:
            await sleep_until_ns(armed.deadline_ns())
            if not armed.overdue():
                continue
            try:
                controlled = await self._call(self._session.check)
            except DeviceError as error:
                self._fail(error)
                return
            if not controlled:
                self._control_lost()
            elif armed.trigger is Trigger.FREE_RUN and armed.overdue():
                armed.fail(self._silent())
            else:
                armed.forgive()

    def _silent(self) -> DeviceTimeout:
        return DeviceTimeout(
            "it answers, but sends no frames.",
            device=self._name,
            operation="frames",
            waited_s=self._silence_s(),
            hint="a smaller packet_size, a firewall that lets UDP in, the frame rate of the camera.",
        )

    def _control_lost(self) -> None:
        if self._control is not None:
            self._fail(
                DeviceLost("control of it was lost.", device=self._name, operation="heartbeat", hint=HINTS[DeviceLost])
            )

    def _fail(self, error: DeviceError) -> None:
        if self._lost is None and isinstance(error, DeviceLost):
            self._lost = error
            log.error("camera lost", device=self._name, reason=error.message)
        if self._armed is not None:
            self._armed.fail(error)

    # -- helpers

    async def _call(self, function: Callable[[Unpack[Ts]], T], *arguments: *Ts) -> T:
        """Run on the control thread unless the camera is lost; a loss found here fails everything that waits."""
        self._refuse_when_lost()
        try:
            return await self._run(function, *arguments)
        except DeviceLost as error:
            self._fail(error)
            raise

    async def _run(self, function: Callable[[Unpack[Ts]], T], *arguments: *Ts) -> T:
        """Run on the control thread, after whatever runs there, also when that was abandoned by a cancelled caller."""
        if self._control is None:
            raise DeviceError("not connected.", device=self._name)
        return await asyncio.get_running_loop().run_in_executor(self._control, function, *arguments)

    def _times(self, settings: CameraSettings) -> Times:
        return Times(
            exposure=round(settings.exposure_s * 1e9),
            margin=round(self._options.exposure_margin_s * 1e9),
            dead=round(self.dead_time_s() * 1e9),
            silence=round(self._silence_s() * 1e9),
        )

    def _configured(self, operation: str) -> CameraSettings:
        if self._settings is None:
            raise DeviceError("not connected.", device=self._name, operation=operation)
        return self._settings

    def _refuse_when_lost(self) -> None:
        if self._lost is not None:
            raise DeviceLost(self._lost.message, device=self._name, hint=HINTS[DeviceLost]) from self._lost

    def _armed_for(self, operation: str) -> Armed:
        if self._armed is None:
            self._refuse_when_lost()
        if self._armed is None:
            raise DeviceError("not armed.", device=self._name, operation=operation)
        return self._armed

    def _refuse_while_armed(self, operation: str) -> None:
        if self._armed is not None:
            raise DeviceBusy("the camera is armed: disarm it first.", device=self._name, operation=operation)


def is_simulated(vendor: str, model: str) -> bool:
    """Whether that is a twin (ours says so in its model) or Aravis' own fake camera."""
    return vendor.lower() == "aravis" or "twin" in model.lower()


def _post(loop: asyncio.AbstractEventLoop, callback: Callable[[Unpack[Ts]], object], *arguments: *Ts) -> None:
    """Call back in the event loop, from any thread; nothing happens when the loop is closed."""
    with suppress(RuntimeError):
        loop.call_soon_threadsafe(callback, *arguments)


def _post_arrival(loop: asyncio.AbstractEventLoop, armed: Armed, arrival: Arrival) -> None:
    loop.call_soon_threadsafe(armed.arrived, arrival)
