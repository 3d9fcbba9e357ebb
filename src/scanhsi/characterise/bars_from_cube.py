"""Contrast of the bars of a USAF 1951 target, from a cube of it (figure 11).

Where the elements lie in the picture is said in a table, for prints of the target differ: a CSV file with the columns ``axis``
(line or sample: along which the bars follow each other), ``bar_mm``, ``first_line``, ``last_line``, ``first_sample``,
``last_sample``.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from scanhsi.calibration.geometry import Geometry
from scanhsi.calibration.resolution import BarContrast, bar_contrast
from scanhsi.characterise.picture import target_picture
from scanhsi.devices.errors import CalibrationError

Axis = Literal["line", "sample"]


@dataclass(frozen=True, slots=True)
class Bars:
    """Where three bars are in a picture; the last line and sample belong to it.

    Attributes:
        axis: Along which they follow each other.
        bar_mm: Width of one.
        lines, samples: First and last.
    """

    axis: str
    bar_mm: float
    lines: tuple[int, int]
    samples: tuple[int, int]


def load_bars(path: str | Path) -> list[Bars]:
    """Read the table of elements.

    Raises:
        CalibrationError: It cannot be read, or a column is missing or no number.
    """
    try:
        with Path(path).open(newline="", encoding="utf-8") as file:
            return [
                Bars(
                    row["axis"].strip(),
                    float(row["bar_mm"]),
                    (int(row["first_line"]), int(row["last_line"])),
                    (int(row["first_sample"]), int(row["last_sample"])),
                )
                for row in csv.DictReader(file)
            ]
    except (OSError, KeyError, ValueError, AttributeError, TypeError) as error:
        raise CalibrationError(f"{path} is no table of bars: {error!r}.") from error


def bars_from_cube(
    cube: str | Path,
    axis: Axis,
    elements: Sequence[Bars],
    *,
    plane: Geometry | None = None,
    threshold: float = 0.2,
) -> BarContrast:
    """Contrast of the elements along one axis, widest bars first; those too fine for the pixels are left out.

    Args:
        cube: Of the target.
        axis: ``line`` along the scan, ``sample`` along the slit.
        elements: Where the bars are; those of the other axis are passed over.
        plane: The geometry as measured; the instrument file's by default.
        threshold: Contrast that counts as resolved.

    Raises:
        CalibrationError: No element lies in the picture; see `bar_contrast`.
    """
    picture = target_picture(cube)
    plane = plane or picture.plane
    stride = abs(float(np.median(picture.steps[1:] - picture.steps[:-1])))
    pitch = float(plane.line_pitch_mm(plane.normal_step)) * stride if axis == "line" else plane.sample_pitch_mm
    height, width = picture.values.shape
    parts = [
        (one.bar_mm, picture.values[one.lines[0] : one.lines[1] + 1, one.samples[0] : one.samples[1] + 1])
        for one in elements
        if one.axis == axis
        and min(*one.lines, *one.samples) >= 0
        and one.lines[1] < height
        and one.samples[1] < width
        and one.bar_mm >= 1.05 * pitch
    ]
    if not parts:
        raise CalibrationError(
            f"no element with bars along the {axis} axis lies in {cube} and is wider than its pixels."
        )
    black, white = (float(np.quantile(picture.values, share)) for share in (0.005, 0.9))
    return bar_contrast(parts, axis, pitch, picture.provenance, black=black, white=white, threshold=threshold)
