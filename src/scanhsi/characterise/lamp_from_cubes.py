"""Wavelengths of the bands from a cube of a spectral lamp."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from scanhsi.calibration.conditions import Conditions
from scanhsi.calibration.dark import DarkModel
from scanhsi.calibration.frames import stack_frames
from scanhsi.calibration.lines import LineList
from scanhsi.calibration.wavelength import Wavelength, calibrate_with_lamp
from scanhsi.characterise.from_cubes import check_dark, opened, provenance_of, split_by_target
from scanhsi.devices.errors import CalibrationError

_SAMPLES: Final = 100
"""Around the middle of the region: smile is nothing there, and this many average well."""


def wavelength_from_cubes(
    cubes: Sequence[str | Path], *, dark: DarkModel | None = None, lines: LineList | None = None, degree: int = 2
) -> Wavelength:
    """Calibrate with a lamp, in the middle of the slit.

    Args:
        cubes: One of the lamp, and a dark one of the same exposure where there is no model.
        dark: Dark model instead.
        lines: Of the lamp; mercury-argon by default.
        degree: Of the polynomial.

    Raises:
        CalibrationError: Not these cubes; see `calibrate_with_lamp`.
    """
    below, lamp = ([], list(cubes)) if dark is not None else split_by_target(cubes)
    if len(lamp) != 1 or (dark is None and len(below) != 1):
        raise CalibrationError(
            f"one cube of the lamp and its dark signal are needed, not {len(lamp)} and {len(below)}."
        )
    datasets = opened(cubes)
    stack = stack_frames(lamp[0])
    if dark is not None:
        check_dark(dark, Conditions.of(datasets[0].attrs))
        if stack.conditions.exposure_s is None:
            raise CalibrationError(f"{lamp[0]} does not say at which exposure it was taken.")
        black = dark.at(stack.conditions.exposure_s)
    else:
        black = stack_frames(below[0]).mean
    middle = stack.mean.shape[1] // 2
    some = slice(max(0, middle - _SAMPLES // 2), middle + _SAMPLES // 2)
    # A hot pixel is a line of its own to whoever looks at a mean; the median of the samples does not see it.
    spectrum = np.median(stack.mean[:, some] - black[:, some], axis=1)
    return calibrate_with_lamp(spectrum, provenance_of(datasets, cubes), lines=lines, degree=degree)
