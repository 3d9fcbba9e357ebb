"""Devices that take no time, to measure the engine alone: each operation goes through the event loop once, as a driver's does."""

from __future__ import annotations

import asyncio

from scanhsi.clock import now_ns
from scanhsi.devices import (
    ActuatorInfo,
    CameraInfo,
    CameraSettings,
    Exposure,
    Frame,
    FrameChannel,
    Motion,
    PixelFormat,
    Pixels,
    Range,
    Trigger,
    check_settings,
)

SHAPE = (1, 1)


class IdleCamera:
    """Exposes for no time; the frame is there at once."""

    def __init__(self) -> None:
        self.info = CameraInfo(
            name="idle camera",
            vendor="scanhsi",
            model="idle",
            serial="",
            firmware="",
            bands=SHAPE[0],
            samples=SHAPE[1],
            pixel_formats=(PixelFormat.MONO8,),
            exposure=Range(0, 1, unit="s"),
            gain=Range(0, 0, unit="dB"),
            simulated=True,
        )
        self._channel = FrameChannel()
        self._index = 0

    async def connect(self) -> None:
        """Nothing to do."""

    async def close(self) -> None:
        """Nothing to do."""

    async def configure(self, settings: CameraSettings) -> CameraSettings:
        """Take anything that is allowed."""
        return check_settings(self.info, settings)

    async def arm(self, trigger: Trigger, buffers: int) -> None:
        """Count frames from 0."""
        self._channel, self._index = FrameChannel(), 0

    async def expose(self) -> Exposure:
        """Expose, and deliver the frame."""
        await asyncio.sleep(0)
        index, now = self._index, now_ns()
        self._index += 1
        self._channel.put(Frame(index, index, None, PixelFormat.MONO8, SHAPE, received_ns=now, first_byte_ns=now))
        return Exposure(index, trigger_ns=now, start_ns=now, end_ns=now, timed=False)

    def frames(self) -> FrameChannel:
        """The frames since `arm`."""
        return self._channel

    async def unpack(self, frame: Frame, out: Pixels | None) -> None:
        """There are no pixels."""

    async def disarm(self) -> None:
        """End the frames."""
        self._channel.close()


class IdleActuator:
    """Is there at once."""

    def __init__(self) -> None:
        self.info = ActuatorInfo(
            name="idle actuator",
            model="idle",
            firmware="",
            steps_per_revolution=19_200,
            limits=Range(-1_000_000, 1_000_000, 1, "steps"),
            max_rate_steps_s=4000.0,
            simulated=True,
        )
        self.position = 0
        self.homed = True

    async def connect(self) -> None:
        """Nothing to do."""

    async def close(self) -> None:
        """Nothing to do."""

    async def home(self) -> Motion:
        """Stand at step 0."""
        return await self.move_to(0)

    async def move_to(self, step: int) -> Motion:
        """Stand at a step."""
        await asyncio.sleep(0)
        self.position, now = step, now_ns()
        return Motion(step, now, now)

    async def stop(self) -> None:
        """Nothing moves."""
