"""Results from cubes, one function a calibration: the same for cubes just taken and for cubes that have been there for years.

Cubes say themselves what they were taken of (``target``) and at which exposure; they may come in any order.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from typing import Final

import xarray as xr

from scanhsi.calibration.applies import Limits, check_applies
from scanhsi.calibration.conditions import Conditions
from scanhsi.calibration.dark import DarkFit, DarkModel
from scanhsi.calibration.frames import frames_of, stack_frames
from scanhsi.calibration.reference import ModelledDark, Reference, average
from scanhsi.calibration.result import Provenance
from scanhsi.calibration.white import WhiteReference, white_reference
from scanhsi.cube.reader import open_cube
from scanhsi.devices.errors import CalibrationError

Path_ = str | Path

_ANY_AGE: Final = Limits(timedelta.max, math.inf)


def opened(cubes: Sequence[Path_]) -> list[xr.Dataset]:
    """The cubes, lazily.

    Raises:
        NotACube, CubeError: One cannot be read.
        CalibrationError: There is none.
    """
    if not cubes:
        raise CalibrationError("there are no cubes to make it from.")
    return [open_cube(cube, chunks=None) for cube in cubes]


def exposure_of(dataset: xr.Dataset, name: Path_) -> float:
    """Exposure in s of a cube.

    Raises:
        CalibrationError: The cube does not say.
    """
    exposure_s = Conditions.of(dataset.attrs).exposure_s
    if exposure_s is None:
        raise CalibrationError(f"{name} does not say at which exposure it was taken.")
    return exposure_s


def provenance_of(datasets: Sequence[xr.Dataset], cubes: Sequence[Path_]) -> Provenance:
    """Of a result made of these cubes."""
    return Provenance.of(*datasets, names=tuple(str(cube) for cube in cubes))


def split_by_target(cubes: Sequence[Path_], dark: str = "dark") -> tuple[list[Path_], list[Path_]]:
    """Dark cubes and the others, as they say themselves.

    Raises:
        CalibrationError: One does not say.
    """
    targets = [dataset.attrs.get("target") for dataset in opened(cubes)]
    unnamed = [str(cube) for cube, target in zip(cubes, targets, strict=True) if target is None]
    if unnamed:
        raise CalibrationError(
            f"these cubes do not say what they were taken of: {', '.join(unnamed)}.",
            hint='scan(..., target="dark"), or name a dark model with dark=',
        )
    pairs = list(zip(cubes, targets, strict=True))
    return [cube for cube, target in pairs if target == dark], [cube for cube, target in pairs if target != dark]


def dark_from_cubes(cubes: Sequence[Path_]) -> DarkModel:
    """Fit a dark model to dark cubes of two exposures or more, frame by frame.

    Raises:
        CalibrationError: Taken under different conditions, or too few; see `DarkFit.fit`.
    """
    datasets = opened(cubes)
    fit = DarkFit()
    for dataset, cube in zip(datasets, cubes, strict=True):
        exposure_s = exposure_of(dataset, cube)
        saturation = dataset["cube"].attrs.get("valid_max")
        for frame in frames_of(dataset, str(cube)):
            fit.add(exposure_s, frame, saturation=saturation)
    return fit.fit(provenance_of(datasets, cubes))


def white_from_cubes(
    white: Path_, dark: Path_ | DarkModel, *, tile: float = 0.99, saturation: float | None = None
) -> WhiteReference:
    """Make a white reference of a cube of the tile.

    Args:
        white: Cube of the tile.
        dark: Dark cube of the same exposure, or a dark model.
        tile: Reflectance of the tile.
        saturation: Counts from which a pixel is saturated; None finds it.

    Raises:
        CalibrationError: They do not go together; see `white_reference`.
    """
    datasets = opened([white])
    stack = stack_frames(white, saturation=saturation)
    names: list[Path_] = [white]
    reference: Reference
    if isinstance(dark, DarkModel):
        check_dark(dark, Conditions.of(datasets[0].attrs))
        reference = ModelledDark("dark model", dark).at(stack.conditions.exposure_s)
    else:
        reference = average(dark)
        datasets += opened([dark])
        names.append(dark)
    provenance = provenance_of(datasets, names)
    if isinstance(dark, DarkModel):
        provenance = replace(provenance, sources=(*provenance.sources, *dark.provenance.sources))
    return white_reference(stack, reference, provenance, tile=tile)


def check_dark(dark: DarkModel, conditions: Conditions) -> None:
    """Refuse a dark model of another gain, format, region or binning; exposures may differ.

    Its age is looked at where it is loaded: `scanhsi.calibration.applies`.

    Raises:
        CalibrationError: Says why.
    """
    check_applies(dark, conditions, _ANY_AGE)
