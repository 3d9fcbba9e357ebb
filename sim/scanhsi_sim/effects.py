"""What a simulated instrument does to the light and to the mirror: every number that a calibration can be asked to find.

The camera has the tables ``sensor``, ``optics``, ``lamp`` and ``target``, the actuator has ``mirror``. What the paper's instrument
does not state is switched off by default; the instrument file ``characterise`` has everything on.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, BaseModel, Field

from scanhsi_sim.geometry import Geometry


def ordered(pair: tuple[float, float]) -> tuple[float, float]:
    """Check that the smallest value comes first."""
    if pair[0] > pair[1]:
        raise ValueError("the smallest value comes first")
    return pair


class _Table(BaseModel, frozen=True, extra="forbid"):
    pass


class SensorOptions(_Table, frozen=True):
    """The sensor, in electrons."""

    full_well_e: float = Field(default=13_500.0, gt=0, description="electrons that a pixel holds")
    full_scale_e: float | None = Field(
        default=None,
        gt=0,
        description="electrons at the ADC's full scale, gain 0 dB; default: the full well. Above it, saturated pixels stand on a "
        "plateau below full scale",
    )
    read_noise_e: float = Field(default=13.0, ge=0, description="temporal noise of reading a pixel")
    shot_noise: bool = Field(default=True, description="whether light and dark current arrive as single electrons")
    offset_e: float = Field(default=100.0, ge=0, description="black level, so that noise around zero is not cut off")
    dsnu_e: float = Field(default=0.0, ge=0, description="standard deviation of the black level over the pixels")
    temperature_c: float = Field(default=25.0, ge=-80, le=120, description="of the sensor")
    dark_e_per_s: float = Field(default=125.0, ge=0, description="mean dark current at 25 degC; it doubles every 7 K")
    dark_spread: float = Field(
        default=0.4, ge=0, description="its log-normal spread over the pixels, standard deviation of the log"
    )
    prnu: float = Field(default=0.01, ge=0, description="relative standard deviation of the response over the pixels")
    hot_per_million: float = Field(default=20.0, ge=0, le=1e6, description="hot pixels in a million")
    hot_e_per_s: Annotated[tuple[float, float], AfterValidator(ordered)] = Field(
        default=(12_500.0, 250_000.0), description="smallest and largest dark current of hot pixels, at 25 degC"
    )
    hot_nonlinear: float = Field(
        default=0.0,
        ge=0,
        le=1,
        description="share of the hot pixels whose dark signal levels off instead of growing on",
    )
    hot_nonlinear_s: float = Field(default=1.0, gt=0, description="time constant with which it does")


class OpticsOptions(_Table, frozen=True):
    """Lens and spectrograph."""

    wavelength_nm: tuple[float, ...] = Field(
        default=(370.79, 2.68, -1e-4),
        min_length=2,
        description="dispersion: polynomial of channel = band / 5, constant first",
    )
    lsf_fwhm_nm: float = Field(default=2.9, gt=0, description="full width at half maximum of the line spread function")
    lsf_blur: float | None = Field(
        default=None,
        ge=0.05,
        le=0.42,
        description="standard deviation of the blur of lens and pixel over that full width, the rest of which is the slit: "
        "0.05 is almost a box; default: a Gaussian",
    )
    smile_px: float = Field(
        default=0.8, ge=-1, le=1, description="bands by which a spectral line is bent at the ends of the slit"
    )
    keystone_px: float = Field(
        default=0.6,
        ge=-1,
        le=1,
        description="samples by which the last band is stretched, and the first shrunk, at the ends",
    )
    vignetting: float = Field(
        default=0.12, ge=0, lt=1, description="share of the light that is missing at the ends of the slit"
    )
    blur_px: float = Field(
        default=0.0, ge=0, description="standard deviation of the lens's point spread function, in samples"
    )
    slit_px: float = Field(
        default=0.0,
        ge=0,
        description="width of the slit, in samples: how far a line reaches along the scan (30 um are 5.45)",
    )


class LampOptions(_Table, frozen=True):
    """The lamp: halogen, or the spectral lamp of scene ``hgar``."""

    temperature_k: float = Field(default=3200.0, gt=0, description="of the halogen lamp's filament")
    white_e_per_s: float = Field(
        default=160e3, gt=0, description="photoelectrons of a white tile in its brightest band"
    )
    hg_e_per_s: float = Field(
        default=160e3, ge=0, description="photoelectrons of the spectral lamp's brightest mercury line"
    )
    ar_e_per_s: float = Field(default=120e3, ge=0, description="photoelectrons of its brightest argon line")
    warm_up: float = Field(
        default=0.0, gt=-1, description="relative brightness above the settled one, when switched on"
    )
    warm_up_s: float = Field(default=180.0, gt=0, description="time constant with which it settles")
    on_before_s: float = Field(
        default=0.0, ge=0, description="how long before the camera connects the lamp was switched on"
    )
    drift_per_min: float = Field(default=0.0, description="relative drift a minute, from switching on")
    flicker: float = Field(default=0.0, ge=0, description="relative standard deviation from frame to frame")


class TargetOptions(_Table, frozen=True):
    """The target in the object plane. Other scenes than targets ignore it."""

    centre_mm: tuple[float, float] = Field(default=(0.0, 0.0), description="x and y of its centre")
    turn_deg: float = Field(default=0.0, ge=-45, le=45, description="by which it lies turned in its plane")
    contrast: float = Field(
        default=0.95, gt=0, le=1, description="one less the reflectance of black over that of white"
    )
    grid_mm: float = Field(default=6.0, gt=0, description="pitch of the Amsler grid")
    grid_line_mm: float = Field(default=0.6, gt=0, description="width of its lines")
    lines_mm: float = Field(default=2.0, gt=0, description="period of the slanted lines, across them")
    lines_deg: float = Field(default=10.0, gt=0, lt=45, description="slant of the lines from the slit")
    edge_deg: float = Field(
        default=5.0, gt=0, lt=45, description="slant of the square whose edges are the slanted edges"
    )
    edge_mm: float = Field(default=40.0, gt=0, description="side of that square")
    certificate: Path | None = Field(
        default=None,
        description="CSV of a wavelength tile: wavelength_nm,reflectance or wavelength_nm,depth,fwhm_nm; default: a made-up one",
    )


class MirrorOptions(_Table, frozen=True):
    """Where the mirror is, other than where it was sent, in its steps."""

    jitter_steps: float = Field(
        default=0.0, ge=0, description="standard deviation of where a motion ends, drawn anew for each"
    )
    periodic_steps: float = Field(
        default=0.0, ge=0, description="amplitude of the error that repeats every 4 full steps of the motor"
    )
    microsteps: int = Field(default=32, gt=0, description="of a full step of the motor, as the driver is set")
    misalignment_steps: float = Field(
        default=0.0, ge=0, description="amplitude of the cosine of a shaft that is out of true"
    )
    misalignment_period_steps: float = Field(
        default=6400.0, gt=0, description="steps of one turn of that shaft (the motor's)"
    )
    misalignment_phase_deg: float = Field(default=0.0, description="of that cosine, at step 0")
    backlash_steps: float = Field(default=0.0, ge=0, description="play: a motion downwards ends that much higher")


@dataclass(frozen=True)
class Setup:
    """Everything that decides what a frame shows.

    Attributes:
        geometry: Sensor shape and object plane.
        seed: Of all that is random.
        sensor, optics, lamp, target: See their classes.
    """

    geometry: Geometry = field(default_factory=Geometry)
    seed: int = 0
    sensor: SensorOptions = field(default_factory=SensorOptions)
    optics: OpticsOptions = field(default_factory=OpticsOptions)
    lamp: LampOptions = field(default_factory=LampOptions)
    target: TargetOptions = field(default_factory=TargetOptions)
