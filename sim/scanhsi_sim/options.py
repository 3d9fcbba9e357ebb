"""What an instrument file may say about the simulated devices."""

from __future__ import annotations

import math
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from scanhsi.devices.errors import ConfigError
from scanhsi.timing.delays import DelayProfile, load_profile
from scanhsi.timing.devices import DeviceTiming
from scanhsi.timing.replay import BLOCK_LINES
from scanhsi_sim.effects import (
    LampOptions,
    MirrorOptions,
    OpticsOptions,
    SensorOptions,
    Setup,
    TargetOptions,
    ordered,
)
from scanhsi_sim.geometry import Geometry
from scanhsi_sim.scenes import SCENES


def find_profile(name: str) -> DelayProfile:
    """A delay profile that ships with the simulator (``"sensors2019"``, ``"ideal"``), or one by the path of its JSON file.

    Raises:
        ConfigError: There is none of that name, or it is not a profile.
    """
    if name.endswith(".json"):
        return load_profile(Path(name))
    return _shipped(name)


@cache
def _shipped(name: str) -> DelayProfile:
    folder = files("scanhsi_sim") / "profiles"
    known = sorted(entry.name.removesuffix(".json") for entry in folder.iterdir() if entry.name.endswith(".json"))
    if name not in known:
        raise ConfigError(
            f"there is no delay profile {name!r}; there are: {', '.join(known)}, or give the path of a .json file."
        )
    return load_profile(Path(str(folder / f"{name}.json")))


def _known_profile(name: str) -> str:
    find_profile(name)
    return name


def _known_scene(name: str) -> str:
    if name not in SCENES:
        raise ValueError(f"there is no scene {name!r}; there are: {', '.join(SCENES)}")
    return name


Pair = Annotated[tuple[float, float], AfterValidator(ordered)]


class _Options(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")

    bench: str = Field(
        default="bench", description="camera and actuator with the same word look at, and turn, the same mirror"
    )
    profile: Annotated[str, AfterValidator(_known_profile)] = Field(
        default="sensors2019", description="delays: sensors2019, ideal (none), or the path of a profile's JSON file"
    )
    seed: int = Field(default=0, ge=0, lt=2**63, description="of everything that is drawn at random")
    block_lines: int = Field(
        default=BLOCK_LINES,
        ge=0,
        description="a recorded profile is replayed in blocks of so many lines on average; 1 takes each line by itself, "
        "0 draws each delay by itself",
    )


class CameraOptions(_Options):
    """Options of the simulated camera."""

    scene: Annotated[str, AfterValidator(_known_scene)] = Field(
        default="hand", description=f"what it looks at: {', '.join(SCENES)}"
    )
    bands: int = Field(default=1088, ge=1, le=8192, description="pixels of the sensor along the spectrum")
    samples: int = Field(default=2048, ge=1, le=8192, description="pixels of the sensor along the slit")
    overlap: bool = Field(default=True, description="whether the next exposure may overlap the read-out of the last")
    whole_transfer: bool = Field(
        default=False,
        description="send all of the sensor and let the host keep the ROI, as the paper did: a small ROI saves no time then",
    )
    exposure_range_s: Pair = Field(default=(0.01, 2.0), description="allowed exposure times in s")
    gain_range_db: Pair = Field(default=(0.0, 25.0), description="allowed gains in dB")
    distance_mm: float = Field(default=350.0, gt=0, description="mirror to object plane, for the scene")
    normal_step: float = Field(default=0, description="mirror step that looks straight at the scene")
    tilt_deg: float = Field(default=0, gt=-45, lt=45, description="of the object plane about the slit's direction")
    pixel_mm: float = Field(default=0.155, gt=0, description="size of a sample in the object plane, straight ahead")
    steps_per_revolution: int = Field(default=19_200, gt=0, description="of the mirror, for the scene")
    sensor: SensorOptions = Field(
        default_factory=SensorOptions, description="noise, dark current, hot pixels, full well"
    )
    optics: OpticsOptions = Field(
        default_factory=OpticsOptions, description="dispersion, line spread, smile, keystone, blur"
    )
    lamp: LampOptions = Field(default_factory=LampOptions, description="brightness, and how it changes over time")
    target: TargetOptions = Field(default_factory=TargetOptions, description="place and measures of the test targets")

    def setup(self) -> Setup:
        """All that decides what a frame shows."""
        geometry = Geometry(
            sensor=(self.bands, self.samples),
            pixel_mm=self.pixel_mm,
            distance_mm=self.distance_mm,
            normal_step=self.normal_step,
            steps_per_revolution=self.steps_per_revolution,
            tilt_rad=math.radians(self.tilt_deg),
        )
        return Setup(geometry, self.seed, self.sensor, self.optics, self.lamp, self.target)


class ActuatorOptions(_Options):
    """Options of the simulated actuator."""

    steps_per_revolution: int = Field(default=19_200, gt=0, description="steps of one turn of the mirror")
    limits: Annotated[tuple[int, int], AfterValidator(ordered)] = Field(
        default=(-2400, 2400), description="lowest and highest step"
    )
    max_rate_steps_s: float = Field(default=4000.0, gt=0, description="highest speed of a sweep")
    home_s: float = Field(default=2.0, ge=0, description="how long homing takes")
    mirror: MirrorOptions = Field(
        default_factory=MirrorOptions, description="jitter, microstepping, misalignment, backlash"
    )


def sends_whole(options: CameraOptions, profile: DelayProfile) -> bool:
    """Whether transfers take as long as the profile says, whatever region is kept; recorded ones do, they are of frames as sent."""
    return options.whole_transfer or bool(profile.scans)


def camera_timing(options: CameraOptions) -> DeviceTiming:
    """The delays that a simulated camera with these options draws."""
    profile = find_profile(options.profile)
    return DeviceTiming(
        profile,
        options.seed,
        sensor=(options.bands, options.samples),
        whole_transfer=sends_whole(options, profile),
        overlap=options.overlap,
        block_lines=options.block_lines,
    )


def actuator_timing(options: ActuatorOptions) -> DeviceTiming:
    """The delays that a simulated actuator with these options draws."""
    return DeviceTiming(find_profile(options.profile), options.seed, block_lines=options.block_lines)
