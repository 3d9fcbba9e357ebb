"""A camera that fails as a plan says, around any camera: its optional abilities are those of the camera inside."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from dataclasses import replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from scanhsi.clock import sleep_until_ns
from scanhsi.devices import (
    Camera,
    CameraInfo,
    CameraSettings,
    Exposure,
    ForetellsEnd,
    Frame,
    FrameChannel,
    FrameStream,
    FreeRunning,
    HardwareTriggered,
    MeasuresTemperature,
    OverlapsReadout,
    Pixels,
    ShowsScenes,
    Trigger,
)
from scanhsi.devices.errors import DeviceError, OutOfRange
from scanhsi.testing.faults import Faults, Kind, for_ever_s
from scanhsi.testing.faulty_frames import Shutter, pump
from scanhsi.testing.faulty_link import FaultyLink
from scanhsi.testing.witness import KnowsScene, Witness


class FaultyCamera:
    """Obeys the camera contract but for what its plan says; made by `faulty_camera`.

    Args:
        inner: The camera.
        faults: The plan under way.
        witness: Told what truly happens, if ``inner`` knows.
    """

    def __init__(self, inner: Camera, faults: Faults, witness: Witness) -> None:
        self.inner = inner
        self._faults = faults
        self._witness = witness
        self._channel = FrameChannel()
        self._pump: asyncio.Task[None] | None = None
        self._name = type(inner).__name__
        self._link = FaultyLink(faults, (Kind.CAMERA_UNPLUGGED, Kind.CONTROL_LOST), self._lose)
        self._exposure_ns = 0
        self._shutter = Shutter()

    @property
    def info(self) -> CameraInfo:
        """As of the camera inside."""
        return self.inner.info

    async def connect(self) -> None:
        """Open it, if it is there."""
        self._link.connect(self._name)
        await self.inner.connect()
        self._name = self.inner.info.name
        if isinstance(self.inner, KnowsScene):
            self._witness.scene = self.inner

    async def close(self) -> None:
        """Close it, wherever it is."""
        self._link.close()
        try:
            await self.inner.close()
        finally:
            self._witness.armed = False
            await self._end()

    async def configure(self, settings: CameraSettings) -> CameraSettings:
        """Configure it, unless it refuses."""
        return await self._call("configure", self._configure(settings))

    async def _configure(self, settings: CameraSettings) -> CameraSettings:
        if self._faults.due(Kind.SETTINGS_REFUSED):
            raise OutOfRange("the camera refuses these settings.", device=self.info.name, operation="configure")
        applied = await self.inner.configure(settings)
        self._exposure_ns = round(applied.exposure_s * 1e9)
        return applied

    async def arm(self, trigger: Trigger, buffers: int) -> None:
        """Arm it; frames come through a stream of our own from here."""
        await self._call("arm", self._arm(trigger, buffers))

    async def _arm(self, trigger: Trigger, buffers: int) -> None:
        await self.inner.arm(trigger, buffers)
        self._witness.arm(buffers)
        self._channel, self._shutter = FrameChannel(), Shutter(exposure_ns=self._exposure_ns)
        work = pump(self.inner.frames(), self._channel, self._shutter, self._faults, self._witness)
        self._pump = asyncio.create_task(work, name="faulty camera")

    async def expose(self) -> Exposure:
        """Expose once."""
        return await self._call("expose", self.expose_by(self.inner.expose))

    async def expose_by(self, expose: Callable[[], Coroutine[Any, Any, Exposure]]) -> Exposure:
        """Expose in a way of the camera inside."""
        self._witness.moved = True
        longer, hangs = self._faults.due(Kind.EXPOSURE_LONGER), self._faults.due(Kind.EXPOSURE_HANGS)
        extra_ns = 0 if longer is None else round((longer.for_s or 0.0) * 1e9)
        self._shutter.longer(extra_ns)
        offset = self._witness.offset
        exposure = await expose()
        end_ns = exposure.end_ns
        if extra_ns:
            exposure = replace(exposure, end_ns=end_ns + extra_ns)
            await sleep_until_ns(exposure.end_ns)
        self._witness.exposed(exposure.start_ns, exposure.start_ns + self._exposure_ns, end_ns + extra_ns, offset)
        if hangs is not None:
            await wait_s(hangs.for_s)
        return exposure

    def frames(self) -> FrameStream:
        """The frames and gaps, as they arrive here."""
        self._link.check(self.info.name, "frames")
        if self._pump is None:
            return self.inner.frames()  # which raises: it is not armed
        return self._channel

    async def unpack(self, frame: Frame, out: Pixels | None) -> None:
        """Unpack a frame, with what the sensor's temperature adds."""
        await self.inner.unpack(frame, out)
        warm = self._witness.warmth(frame.exposure_start_ns)
        if out is not None and warm:
            np.copyto(out, warmed(out, warm, frame.pixel_format.bits))

    async def disarm(self) -> None:
        """Disarm it; a camera that is gone is disarmed, too."""
        await self.inner.disarm()
        self._witness.armed = False
        await self._end()

    async def _call(self, operation: str, call: Coroutine[Any, Any, Any]) -> Any:
        return await self._link.call(self._name, operation, call)

    def _lose(self, error: DeviceError) -> None:
        error.device, error.operation = self.info.name, "frames"
        self._channel.fail(error)

    async def _end(self) -> None:
        """What has arrived stays readable; what a fault holds up, comes now."""
        self._shutter.disarmed.set()
        if self._pump is not None:
            await asyncio.wait([self._pump])
            self._pump = None


async def wait_s(for_s: float | None) -> None:
    """Wait; None: for ever."""
    if for_s is None:
        await asyncio.Event().wait()
    await asyncio.sleep(for_ever_s(for_s))


def warmed(pixels: NDArray[Any], counts: int, bits: int) -> NDArray[Any]:
    """Pixels of a sensor whose dark level has risen by so much, cut at full scale."""
    return np.minimum(pixels.astype(np.int64) + counts, 2**bits - 1).astype(pixels.dtype)


class _Triggered(FaultyCamera):
    def shortest_trigger_period_s(self) -> float:
        return cast(HardwareTriggered, self.inner).shortest_trigger_period_s()


class _FreeRunning(FaultyCamera):
    async def set_frame_period(self, period_s: float) -> float:
        return await cast(FreeRunning, self.inner).set_frame_period(period_s)


class _Overlapping(FaultyCamera):
    def dead_time_s(self) -> float:
        return cast(OverlapsReadout, self.inner).dead_time_s()


class _Foretelling(FaultyCamera):
    async def expose_foretold(self, foretold: Callable[[int], None]) -> Exposure:
        inner = cast(ForetellsEnd, self.inner)
        return await self._call("expose", self.expose_by(lambda: inner.expose_foretold(foretold)))


class _Measuring(FaultyCamera):
    async def temperature_c(self) -> float | None:
        self._link.check(self._name, "temperature")
        return await cast(MeasuresTemperature, self.inner).temperature_c()


class _Showing(FaultyCamera):
    @property
    def scenes(self) -> tuple[str, ...]:
        return cast(ShowsScenes, self.inner).scenes

    @property
    def scene(self) -> str:
        return cast(ShowsScenes, self.inner).scene

    async def show(self, scene: str) -> None:
        await cast(ShowsScenes, self.inner).show(scene)


_ABILITIES: tuple[tuple[type, type[FaultyCamera]], ...] = (
    (HardwareTriggered, _Triggered),
    (FreeRunning, _FreeRunning),
    (OverlapsReadout, _Overlapping),
    (ForetellsEnd, _Foretelling),
    (MeasuresTemperature, _Measuring),
    (ShowsScenes, _Showing),
)
_classes: dict[tuple[type, ...], type[FaultyCamera]] = {}


def faulty_camera(inner: Camera, faults: Faults, witness: Witness | None = None) -> FaultyCamera:
    """Put a plan's faults around a camera.

    Args:
        inner: Any camera.
        faults: The plan under way.
        witness: Told what truly happens, if ``inner`` knows.
    """
    parts = tuple(part for ability, part in _ABILITIES if isinstance(inner, ability))
    if parts not in _classes:  # an ability is having its methods, so each set of abilities is a class
        _classes[parts] = type("FaultyCamera", parts or (FaultyCamera,), {})
    return _classes[parts](inner, faults, witness or Witness(keeps=False))
