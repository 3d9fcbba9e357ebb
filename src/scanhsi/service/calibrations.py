"""Calibrations that can be asked for, and with which options."""

from __future__ import annotations

import inspect
from typing import Any, Final, Literal, get_args

from pydantic import Field

from scanhsi.calibration.kinds import load_any
from scanhsi.characterise.calibrator import Calibrator
from scanhsi.devices.errors import ConfigError
from scanhsi.service.folder import Folder
from scanhsi.service.models import Body, Name

Calibration = Literal[
    "dark",
    "white",
    "photon_transfer",
    "snr",
    "light",
    "wavelength",
    "smile",
    "keystone",
    "geometry",
    "resolution",
    "jitter",
    "backlash",
    "repeatability",
]
CALIBRATIONS: Final[tuple[str, ...]] = get_args(Calibration)
_RESULTS: Final = ("dark", "plane")


class CalibrationBody(Body):
    """A calibration to be made. An option that its protocol does not know is refused; what is left out is as usual."""

    kind: Calibration
    output: Name | None = Field(default=None, description="File of the result; a name with date and time if left out.")
    exposure_s: float | None = Field(default=None, gt=0, description="Found by auto-exposure if left out.")
    exposures_s: list[float] | None = Field(default=None, min_length=1, max_length=50, description="Of a series.")
    frames: int | None = Field(default=None, ge=2, le=1000, description="To average.")
    dark: Name | None = Field(
        default=None, description="Dark model in the data folder; else dark frames are taken, too."
    )
    plane: Name | None = Field(default=None, description="Geometry in the data folder; else the instrument file's.")
    tile: float | None = Field(default=None, gt=0, le=1, description="Reflectance of the white tile.")
    half_mm: float | None = Field(default=None, gt=0, le=10_000, description="How far a scan goes to both sides.")
    pitch_mm: float | None = Field(default=None, gt=0, le=1000, description="Of the grid.")
    slant_deg: float | None = Field(default=None, gt=0, lt=90, description="Of slanted lines.")
    axis: Literal["line", "sample"] | None = Field(default=None, description="Along the scan, or along the slit.")
    runs: int | None = Field(default=None, ge=1, le=100)
    snapshots: int | None = Field(default=None, ge=2, le=1000, description="Of the lamp.")
    interval_s: float | None = Field(default=None, ge=0, le=3600, description="From snapshot to snapshot.")


def options_of(body: CalibrationBody, folder: Folder) -> dict[str, Any]:
    """Options of the protocol, results in the data folder loaded. Blocking.

    Raises:
        ConfigError: The protocol does not know one.
        NoSuch, CalibrationError: A result is not there, or cannot be read.
    """
    given = body.model_dump(exclude={"kind", "output"}, exclude_none=True)
    known = inspect.signature(getattr(Calibrator, body.kind)).parameters
    problems = [f"{name}: {body.kind} has no such option" for name in given if name not in known]
    if problems:
        raise ConfigError("the calibration cannot be made as asked:", problems)
    return {name: load_any(folder.result(value)) if name in _RESULTS else value for name, value in given.items()}
