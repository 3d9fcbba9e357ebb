"""What the tests of the camera contract are made of."""

from __future__ import annotations

from typing import ClassVar

from scanhsi.devices import Camera, CameraSettings, FrameEvent, PixelFormat, Roi, Trigger
from scanhsi.testing.devices import DeviceConformance

BUFFERS = 8


class CameraSuite(DeviceConformance[Camera]):
    """What the tests of cameras are made of.

    Attributes:
        exposure_s: Exposure time that the tests use; the shortest allowed one if it is longer.
        shape: (bands, samples) of the region that the tests read; clipped to the sensor and its granularity.
        loses_frames: The device may lose a frame now and then, as a real network does: a gap is then no failure where the
            contract allows one.
    """

    exposure_s: ClassVar[float] = 0.01
    shape: ClassVar[tuple[int, int]] = (32, 64)
    loses_frames: ClassVar[bool] = False

    def settings(self, camera: Camera, pixel_format: PixelFormat | None = None) -> CameraSettings:
        """Settings that the camera allows."""
        info = camera.info
        bands, samples = (
            max(step, min(wanted, whole) // step * step)
            for wanted, whole, step in zip(self.shape, (info.bands, info.samples), info.roi_step, strict=True)
        )
        return CameraSettings(
            exposure_s=max(self.exposure_s, info.exposure.minimum),
            gain_db=info.gain.minimum,
            pixel_format=pixel_format or info.pixel_formats[0],
            roi=Roi(0, 0, samples, bands),
        )

    async def ready(self, camera: Camera, buffers: int = BUFFERS) -> CameraSettings:
        """Configure and arm for software triggers."""
        applied = await camera.configure(self.settings(camera))
        await camera.arm(Trigger.SOFTWARE, buffers)
        return applied

    async def take(self, camera: Camera, count: int) -> list[FrameEvent]:
        """Expose and receive one after the other, until so many exposures have ended as a frame or in a gap."""
        stream, events = camera.frames(), list[FrameEvent]()
        for _ in range(count):
            await camera.expose()
            events.append(await anext(stream))
        return events
