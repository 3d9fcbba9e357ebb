"""The three scenarios of Fig. 6, as instruments: the engine and the devices run as ever, and lack one thing to do.

* **full**: everything.
* **static**: the mirror stands. The engine asks for each move; a thin actuator in front of the real one says it has arrived.
* **acquire**: the mirror stands, and frames are let go as they arrive: nobody unpacks or stores them.
"""

from __future__ import annotations

from dataclasses import replace
from enum import StrEnum, unique

from scanhsi.clock import now_ns
from scanhsi.devices import (
    Actuator,
    ActuatorInfo,
    Camera,
    CameraInfo,
    CameraSettings,
    Exposure,
    Frame,
    FrameStream,
    Motion,
    Pixels,
    Trigger,
)
from scanhsi.imager import Imager


@unique
class Scenario(StrEnum):
    """How much of a line is done."""

    FULL = "full"
    STATIC = "static"
    ACQUIRE = "acquire"

    @property
    def words(self) -> str:
        """For people."""
        return {"full": "full", "static": "mirror static", "acquire": "acquire and discard"}[self.value]


def staged(imager: Imager, scenario: Scenario) -> Imager:
    """The same open instrument in a scenario."""
    if scenario is Scenario.FULL:
        return imager
    instrument = imager.instrument
    camera = Unread(instrument.camera) if scenario is Scenario.ACQUIRE else instrument.camera
    return Imager(replace(instrument, camera=camera, actuator=Standing(instrument.actuator)), imager.run)


class Standing:
    """An actuator whose mirror stays where it is, and which says that it has moved."""

    def __init__(self, inner: Actuator) -> None:
        self._inner = inner
        self._step: int | None = None

    @property
    def info(self) -> ActuatorInfo:
        """Of the actuator behind."""
        return self._inner.info

    @property
    def position(self) -> int:
        """Where the mirror is said to be."""
        return self._inner.position if self._step is None else self._step

    @property
    def homed(self) -> bool:
        """Of the actuator behind."""
        return self._inner.homed

    async def connect(self) -> None:
        """Connect the actuator behind."""
        await self._inner.connect()

    async def close(self) -> None:
        """Close the actuator behind."""
        await self._inner.close()

    async def home(self) -> Motion:
        """Home the actuator behind."""
        return await self._inner.home()

    async def move_to(self, step: int) -> Motion:
        """Arrive at once, without a motion."""
        self.info.limits.check("step", step, device=self.info.name)
        self._step = step
        now = now_ns()
        return Motion(step, now, now)

    async def stop(self) -> None:
        """Stop the actuator behind."""
        await self._inner.stop()


class Unread:
    """A camera whose frames are received and never unpacked. It has no optional ability: it serves step modes."""

    def __init__(self, inner: Camera) -> None:
        self._inner = inner

    @property
    def info(self) -> CameraInfo:
        """Of the camera behind."""
        return self._inner.info

    async def connect(self) -> None:
        """Connect the camera behind."""
        await self._inner.connect()

    async def close(self) -> None:
        """Close the camera behind."""
        await self._inner.close()

    async def configure(self, settings: CameraSettings) -> CameraSettings:
        """Configure the camera behind."""
        return await self._inner.configure(settings)

    async def arm(self, trigger: Trigger, buffers: int) -> None:
        """Arm the camera behind."""
        await self._inner.arm(trigger, buffers)

    async def expose(self) -> Exposure:
        """Expose with the camera behind."""
        return await self._inner.expose()

    def frames(self) -> FrameStream:
        """Of the camera behind."""
        return self._inner.frames()

    async def unpack(self, frame: Frame, out: Pixels | None) -> None:
        """Let the frame go."""

    async def disarm(self) -> None:
        """Disarm the camera behind."""
        await self._inner.disarm()
