"""Small drivers that come in through the entry-point door, for tests of configuration, instrument and command line."""

import asyncio
from importlib.metadata import EntryPoint
from typing import ClassVar

from pydantic import Field

from scanhsi.devices import (
    ActuatorInfo,
    Backend,
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
)
from scanhsi.devices.errors import DeviceLost, DeviceNotFound
from scanhsi.instrument.quantities import Seconds, Written


class Options(Written):
    """Options of both spare drivers."""

    address: str = Field(default="here", description="Where it is.")
    settle_s: Seconds = Field(default=0.0, alias="settle", ge=0, description="Time to rest.")
    seed: int = Field(default=0, description="Of what is random.")
    fault: str = Field(default="", description="What goes wrong: connect, close, hang, crash.")


class Seedless(Written):
    """Options of a driver that draws nothing."""

    address: str


class Spare:
    """Life cycle of both devices; `JOURNAL` tells in which order things happened."""

    opened: ClassVar[set["Spare"]] = set()

    def __init__(self, options: Options, word: str) -> None:
        self.options = options
        self.word = word

    async def connect(self) -> None:
        await asyncio.sleep(0.1)
        JOURNAL.append(f"connect {self.word}")
        match self.options.fault:
            case "connect":
                raise DeviceNotFound(
                    f"nothing answers at {self.options.address}.", device=f"{self.word} spare", operation="connect"
                )
            case "crash":
                raise ZeroDivisionError("a bug in a driver")
            case "hang":
                await asyncio.sleep(1000)
            case _:
                Spare.opened.add(self)

    async def close(self) -> None:
        await asyncio.sleep(0.1)
        JOURNAL.append(f"close {self.word}")
        Spare.opened.discard(self)
        if self.options.fault == "close":
            raise DeviceLost("it did not say goodbye.", device=f"{self.word} spare", operation="close")


JOURNAL: list[str] = []


class SpareCamera(Spare):
    """A camera that opens and closes."""

    def __init__(self, options: Options) -> None:
        super().__init__(options, "camera")

    @property
    def info(self) -> CameraInfo:
        return CameraInfo(
            name=f"camera spare {self.options.address}",
            vendor="scanhsi",
            model="Spare",
            serial="1",
            firmware="1.0",
            bands=64,
            samples=128,
            pixel_formats=(PixelFormat.MONO8, PixelFormat.MONO12_PACKED),
            exposure=Range(21e-6, 153.0, 1e-6, "s"),
            gain=Range(0, 24, 0.1, "dB"),
            triggers=frozenset({Trigger.SOFTWARE, Trigger.LINE}),
            simulated=True,
        )

    async def configure(self, settings: CameraSettings) -> CameraSettings:
        return settings

    async def arm(self, trigger: Trigger, buffers: int) -> None: ...

    async def expose(self) -> Exposure:
        raise NotImplementedError

    def frames(self) -> FrameChannel:
        return FrameChannel()

    async def unpack(self, frame: Frame, out: Pixels | None) -> None: ...

    async def disarm(self) -> None: ...


class SpareActuator(Spare):
    """An actuator that opens and closes."""

    homed = True
    position = 0

    def __init__(self, options: Options) -> None:
        super().__init__(options, "actuator")

    @property
    def info(self) -> ActuatorInfo:
        return ActuatorInfo(
            name=f"actuator spare {self.options.address}",
            model="Spare",
            firmware="1.0",
            steps_per_revolution=19_200,
            limits=Range(-2400, 2400, 1, "steps"),
            max_rate_steps_s=4000.0,
            simulated=True,
        )

    async def home(self) -> Motion:
        return Motion(0, 0, 0)

    async def move_to(self, step: int) -> Motion:
        return Motion(step, 0, 0)

    async def stop(self) -> None: ...


camera_backend = Backend("A camera that opens and closes.", Options, SpareCamera, SpareCamera, virtual_time=True)
actuator_backend = Backend(
    "An actuator that opens and closes.", Options, SpareActuator, SpareActuator, virtual_time=True
)
wired_backend = Backend(
    "A camera that does real I/O and lacks a library.",
    Seedless,
    SpareCamera,
    SpareCamera,
    missing=lambda: "libspare is missing; apt install libspare.",
)

POINTS = {
    "scanhsi.cameras": [
        EntryPoint("broken", "support.no_such_module:backend", "scanhsi.cameras"),
        EntryPoint("spare", "support.spare_drivers:camera_backend", "scanhsi.cameras"),
        EntryPoint("wired", "support.spare_drivers:wired_backend", "scanhsi.cameras"),
    ],
    "scanhsi.actuators": [EntryPoint("spare", "support.spare_drivers:actuator_backend", "scanhsi.actuators")],
}


def spare_entry_points(*, group: str) -> list[EntryPoint]:
    """In place of `importlib.metadata.entry_points`."""
    return POINTS.get(group, [])
