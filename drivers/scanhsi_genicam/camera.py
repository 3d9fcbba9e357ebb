"""`GenicamCamera`: the camera contract over a blocking `Session`, which runs on one thread of its own.

One trigger is in flight at a time: the next waits for the frame before it. So it is known, with any camera, which exposure a
frame belongs to.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from typing import TypeVar, TypeVarTuple, Unpack

from scanhsi.clock import sleep_until_ns
from scanhsi.devices.camera import CameraInfo, CameraSettings, Exposure, Trigger, check_settings
from scanhsi.devices.errors import DeviceBusy, DeviceError, DeviceLost, OutOfRange, UnsupportedFeature
from scanhsi.devices.frames import Frame, FrameStream, Pixels
from scanhsi.devices.pixels import unpack
from scanhsi_genicam.armed import Armed, Pending, Times
from scanhsi_genicam.errors import device_name, make
from scanhsi_genicam.options import GenicamOptions
from scanhsi_genicam.session import Arrival, Session

T = TypeVar("T")
Ts = TypeVarTuple("Ts")


class GenicamCamera:
    """A GenICam camera with software triggers. The end of an exposure is timed.

    Args:
        options: What the instrument file says.
    """

    def __init__(self, options: GenicamOptions) -> None:
        self._options = options
        self._name = device_name(options.address)
        self._session = Session(options, self._name)
        self._control: ThreadPoolExecutor | None = None
        self._info: CameraInfo | None = None
        self._settings: CameraSettings | None = None
        self._armed: Armed | None = None
        self._watcher: asyncio.Task[None] | None = None
        self._lost: DeviceLost | None = None

    @property
    def info(self) -> CameraInfo:
        """What the camera is and allows."""
        if self._info is None:
            raise DeviceError("not connected.", device=self._name, operation="info")
        return self._info

    async def connect(self) -> None:
        """Find the camera and take control of it."""
        if self._control is not None:
            raise DeviceBusy("connected already.", device=self._name, operation="connect")
        self._control = ThreadPoolExecutor(1, "genicam-control")
        try:
            self._info = await self._call(self._session.open)
        except BaseException:
            await self.close()
            raise

    async def close(self) -> None:
        """Disarm, give up control, free everything but what a consumer still views."""
        with suppress(DeviceError):
            await self.disarm()
        control, self._control = self._control, None
        if control is not None:
            await asyncio.shield(asyncio.get_running_loop().run_in_executor(control, self._session.close))
            control.shutdown(wait=False)
        self._info = self._settings = self._lost = None

    async def configure(self, settings: CameraSettings) -> CameraSettings:
        """Apply settings; exposure and gain come back as the camera rounded them."""
        wanted = check_settings(self.info, settings)
        self._refuse_while_armed("configure")
        self._settings = await self._call(self._session.configure, wanted, self.info)
        return self._settings

    async def temperature_c(self) -> float | None:
        """How warm the camera is, where its ``DeviceTemperatureSelector`` points; armed or not."""
        return await self._call(self._session.temperature_c)

    async def arm(self, trigger: Trigger, buffers: int) -> None:
        """Start the stream; exposures begin with `expose`."""
        self._refuse_while_armed("arm")
        if self._settings is None:
            raise DeviceError("not configured.", device=self._name, operation="arm", hint="call configure first.")
        if buffers < 1:
            raise OutOfRange(f"{buffers} buffers are not enough.", device=self._name, operation="arm")
        if trigger is not Trigger.SOFTWARE:
            raise UnsupportedFeature(
                f"this driver knows only software triggers, not {trigger}.", device=self._name, operation="arm"
            )
        armed = self._armed = Armed(self._settings, self._times(self._settings))  # from here on disarm undoes it
        try:
            await self._call(self._session.start, buffers, self._delivery(armed))
        except DeviceError:
            with suppress(DeviceError):
                await self.disarm()
            raise
        self._watcher = asyncio.create_task(self._watch(armed), name=f"{self._name}: watchdog")

    async def expose(self) -> Exposure:
        """Trigger one exposure, once the frame before it is here; return at the end of exposure (timed)."""
        armed = self._armed_for("expose")
        await sleep_until_ns(await armed.may_trigger())
        loop, pending = asyncio.get_running_loop(), Pending()

        def fire() -> (
            None
        ):  # tells from the control thread, so that the count is right even when this call is cancelled
            try:
                self._session.fire(
                    lambda at_ns: _post(loop, armed.triggered, pending, at_ns),
                    lambda at_ns: _post(loop, armed.confirmed, pending, at_ns),
                )
            except DeviceError:
                _post(loop, armed.refused, pending)
                raise

        await self._call(fire)
        await sleep_until_ns(pending.end_ns)
        return Exposure(pending.index, pending.sent_ns, pending.sent_ns, pending.end_ns, timed=True)

    def frames(self) -> FrameStream:
        """Frames and gaps since ``arm()``."""
        return self._armed_for("frames").channel

    async def unpack(self, frame: Frame, out: Pixels | None) -> None:
        """Copy or unpack; at most some milliseconds of work, done here and now."""
        if out is not None and frame.payload is not None:
            unpack(frame.payload, frame.pixel_format, out)

    async def disarm(self) -> None:
        """Stop exposing; exposures whose frame has not come end as gaps."""
        armed, watcher = self._armed, self._watcher
        if armed is None:
            return
        try:
            if watcher is not None:
                watcher.cancel()
                await asyncio.wait([watcher])
            await self._run(self._session.stop)
        finally:
            armed.finish()
            self._armed = self._watcher = None

    # -- helpers

    def _delivery(self, armed: Armed) -> Callable[[Arrival | DeviceError], object]:
        loop = asyncio.get_running_loop()

        def deliver(arrival: Arrival | DeviceError) -> None:
            if isinstance(arrival, DeviceError):
                loop.call_soon_threadsafe(self._fail, arrival)
            else:
                loop.call_soon_threadsafe(armed.arrived, arrival)

        return deliver

    async def _watch(self, armed: Armed) -> None:
        while armed.error is None:
            await armed.overdue()
            try:
                await self._call(self._session.check)
            except DeviceError as error:
                self._fail(error)
                return
            armed.give_up()

    def _times(self, settings: CameraSettings) -> Times:
        options = self._options
        return Times(
            exposure=round((settings.exposure_s + options.exposure_margin_s) * 1e9),
            readout=round(self.info.readout_s * 1e9),
            silence=round(options.frame_timeout_s * 1e9),
        )

    def _fail(self, error: DeviceError) -> None:
        if self._lost is None and isinstance(error, DeviceLost):
            self._lost = error
        if self._armed is not None:
            self._armed.fail(error)

    async def _call(self, function: Callable[[Unpack[Ts]], T], *arguments: *Ts) -> T:
        """Run on the control thread unless the camera is lost; a loss found here fails everything that waits."""
        if self._lost is not None:
            raise make(DeviceLost, self._lost.message, self._name) from self._lost
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

    def _armed_for(self, operation: str) -> Armed:
        if self._armed is None:
            raise DeviceError("not armed.", device=self._name, operation=operation)
        return self._armed

    def _refuse_while_armed(self, operation: str) -> None:
        if self._armed is not None:
            raise DeviceBusy("the camera is armed: disarm it first.", device=self._name, operation=operation)


def _post(loop: asyncio.AbstractEventLoop, callback: Callable[[Unpack[Ts]], object], *arguments: *Ts) -> None:
    """Call back in the event loop, from any thread; nothing happens when the loop is closed."""
    with suppress(RuntimeError):
        loop.call_soon_threadsafe(callback, *arguments)
