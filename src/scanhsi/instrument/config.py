"""What an instrument is: one TOML file, checked as a whole before any device is touched.

::

    description = "..."
    [camera]        driver = "..." and the options of that driver
    [actuator]      driver = "..." and the options of that driver
    [light]         driver = "..." and the options of that driver; left out where nothing can be switched
    [geometry]      mirror and object
    [spectral]      wavelength of each band
    [roi]           part of the sensor that is read out (default: all of it)
    [limits]        what this instrument allows, within what its devices allow
    [storage]       how cubes are written
    [scan]          plan of a scan that says nothing else

`scanhsi.instrument.load.load_instrument` reads one; ``scanhsi schema`` prints its JSON schema.
"""

from __future__ import annotations

import math
from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from scanhsi.devices import PixelFormat, Roi
from scanhsi.devices.errors import ConfigError
from scanhsi.instrument.device_config import ActuatorConfig, CameraConfig, LightConfig
from scanhsi.instrument.quantities import Decibels, Metres, Seconds, Steps, Written


class Geometry(Written):
    """Mirror and object plane (Sensors 2019, Eqs. 5, 8, 10 and 11).

    The paper's equations disagree on the direction of y. Here the mirror angle counts from the normal position and
    ``scan_direction`` says whether it grows or falls with the step; the place on the object plane is y = -r tan(2 angle), as in
    Eqs. 5 and 12.
    """

    steps_per_revolution: Annotated[int, Field(gt=0, description="motor steps of one turn of the mirror")] = 19_200
    distance_m: Annotated[Metres, Field(alias="distance", gt=0, description="mirror axis to object plane")]
    normal_step: Annotated[
        Steps, Field(description="step at which the optical axis meets the object plane at a right angle")
    ]
    scan_direction: Annotated[
        Literal[1, -1], Field(description="+1 when the mirror angle grows with the step, -1 when it falls")
    ] = 1

    sample_pitch_m: Annotated[
        Metres | None,
        Field(alias="sample_pitch", gt=0, description="size of a sample in the object plane, straight ahead"),
    ] = None

    @property
    def step_angle_rad(self) -> float:
        """Angle the mirror turns in one step (Eq. 8); the optical axis turns by twice as much."""
        return 2 * math.pi / self.steps_per_revolution

    def angle_rad(self, step: float) -> float:
        """Mirror angle at a step, counted from the normal position, in which the mirror stands at 45 degrees."""
        return self.scan_direction * (step - self.normal_step) * self.step_angle_rad


class Spectral(Written):
    """Wavelength of the bands: a polynomial of the channel, which may be several sensor rows wide."""

    wavelength_nm: Annotated[
        tuple[float, ...],
        Field(min_length=2, description="coefficients in nm, constant first, of the polynomial in the channel number"),
    ]
    bands_per_channel: Annotated[int, Field(ge=1, description="sensor bands of one channel of the polynomial")] = 1

    def wavelengths_nm(self, bands: int, first: int = 0) -> NDArray[np.float64]:
        """Wavelength of ``bands`` sensor bands from ``first`` on, in nm, float64."""
        channel = (first + np.arange(bands, dtype=np.float64)) / self.bands_per_channel
        return np.asarray(np.polynomial.polynomial.polyval(channel, np.asarray(self.wavelength_nm)), np.float64)


class RoiConfig(Written):
    """Region of the sensor that is read out, in pixels."""

    samples: Annotated[int, Field(ge=1, description="pixels along the slit")]
    bands: Annotated[int, Field(ge=1, description="pixels along the spectrum")]
    sample_offset: Annotated[int, Field(ge=0, description="first pixel along the slit")] = 0
    band_offset: Annotated[int, Field(ge=0, description="first pixel along the spectrum")] = 0

    @property
    def roi(self) -> Roi:
        """As cameras take it."""
        return Roi(self.sample_offset, self.band_offset, self.samples, self.bands)


class Limits(Written):
    """What this instrument allows, where that is less than its devices allow; each is [smallest, largest]."""

    exposure_s: Annotated[tuple[Seconds, Seconds] | None, Field(alias="exposure", description="exposure times")] = None
    gain_db: Annotated[tuple[Decibels, Decibels] | None, Field(alias="gain", description="gains")] = None
    steps: Annotated[
        tuple[Steps, Steps] | None,
        Field(description="mirror positions, a sweep's run-up and run-out included"),
    ] = None

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        for pair in (self.exposure_s, self.gain_db, self.steps):
            if pair is not None and pair[0] > pair[1]:
                raise ValueError("the smallest value comes first in each pair")
        return self


class Storage(Written):
    """How cubes are written."""

    lines_per_shard: Annotated[
        int | None, Field(ge=1, description="lines of one file of the cube; left out, it follows from the line size")
    ] = None
    codec: Annotated[
        Literal["lz4", "zstd", "none", "raw"],
        Field(description="lz4 is quick, zstd is smaller; raw is for streams too fast to be compressed"),
    ] = "lz4"
    durability: Annotated[
        Literal["every shard", "at close"], Field(description="when stored lines survive a power cut")
    ] = "every shard"
    bin_bands: Annotated[int, Field(ge=1, description="neighbouring bands summed into one")] = 1
    bin_samples: Annotated[int, Field(ge=1, description="neighbouring samples summed into one")] = 1
    quicklook: Annotated[bool, Field(description="write a colour picture at an eighth of the size beside the cube")] = (
        True
    )


class ScanDefaults(Written):
    """The plan of a scan that says nothing else. What is left out here is left to the plan's own defaults."""

    mode: Annotated[
        Literal["sequential", "stepped", "continuous"] | None, Field(description="how mirror and camera take turns")
    ] = None
    lines: Annotated[int | None, Field(ge=1, description="lines of the cube")] = None
    step: Annotated[Steps | None, Field(description="motor steps between lines; negative scans downwards")] = None
    start: Annotated[Steps | None, Field(description="step of the first line")] = None
    exposure_s: Annotated[Seconds | None, Field(alias="exposure", gt=0, description="exposure time of a line")] = None
    gain_db: Annotated[Decibels | None, Field(alias="gain", description="analogue gain")] = None
    pixel_format: Annotated[PixelFormat | None, Field(description="pixel format on the link")] = None
    period_s: Annotated[Seconds | None, Field(alias="period", gt=0, description="line period of a continuous scan")] = (
        None
    )
    look_ahead: Annotated[
        float | None,
        Field(
            ge=0, le=0.5, description="stepped scans: send moves early, with this probability that a line is smeared"
        ),
    ] = None
    on_fault: Annotated[
        Literal["abort", "skip", "retry"] | None, Field(description="what to do about lost frames and lost devices")
    ] = None
    line_retries: Annotated[int | None, Field(ge=0, le=250, description="how often one line may be tried again")] = None
    retries: Annotated[int | None, Field(ge=0, description="how often lines may be tried again in all")] = None
    recover_within_s: Annotated[
        Seconds | None, Field(alias="recover_within", gt=0, description="time in which a lost device must be back")
    ] = None


class InstrumentConfig(Written):
    """A whole instrument file."""

    name: Annotated[str, Field(min_length=1, description="name of the instrument; left out, that of the file")]
    description: Annotated[str, Field(description="what it is, for people")] = ""
    camera: CameraConfig
    actuator: ActuatorConfig
    light: LightConfig | None = None
    geometry: Geometry
    spectral: Spectral | None = None
    roi: RoiConfig | None = None
    limits: Limits = Limits()
    storage: Storage = Storage()
    scan: ScanDefaults = ScanDefaults()

    @property
    def virtual_time(self) -> bool:
        """Whether every device runs in virtual time, too."""
        devices = (self.camera, self.actuator, *([self.light] if self.light else []))
        return all(device.backend.virtual_time for device in devices)

    def with_delays(self, profile: str) -> InstrumentConfig:
        """A copy whose simulated devices spend the delays of another profile; a recorded one is replayed.

        Args:
            profile: Path of its JSON file, or name of one that the drivers know.

        Raises:
            ConfigError: A device is not simulated, and takes the time it takes; or there is no such profile.
        """
        devices = (self.camera, self.actuator)
        real = [device for device in devices if "profile" not in type(device.options).model_fields]
        if real:
            raise ConfigError(
                f"instrument {self.name} cannot replay delays:",
                [f"{device.role.word}.driver = {device.driver!r} is not simulated" for device in real],
                hint="replay them in a simulated instrument, such as sensors2019.",
            )
        return self.model_copy(
            update={
                "camera": self.camera.with_option("profile", profile),
                "actuator": self.actuator.with_option("profile", profile),
            }
        )

    def with_seed(self, seed: int) -> InstrumentConfig:
        """A copy whose simulated devices draw from another seed.

        Raises:
            ConfigError: A device is not simulated, so that a seed would be ignored.
        """
        devices = (self.camera, self.actuator)
        unseeded = [device for device in devices if "seed" not in type(device.options).model_fields]
        if unseeded:
            raise ConfigError(
                f"instrument {self.name} cannot be given a seed:",
                [f"{device.role.word}.driver = {device.driver!r} draws nothing at random" for device in unseeded],
            )
        return self.model_copy(
            update={
                "camera": self.camera.with_option("seed", seed),
                "actuator": self.actuator.with_option("seed", seed),
            }
        )
