"""Contrast of the bars of a USAF 1951 target, from a cube of it (figure 11).

Where the elements lie in the picture is found from the layout of the target (`find_bars`), or said in a table: a CSV file with
the columns ``axis`` (line or sample: along which the bars follow each other), ``bar_mm``, ``first_line``, ``last_line``,
``first_sample``, ``last_sample``.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from scanhsi.calibration.geometry import Geometry
from scanhsi.calibration.resolution import BarContrast, bar_contrast
from scanhsi.calibration.usaf import Element, columns, place_target
from scanhsi.characterise.picture import target_picture
from scanhsi.devices.errors import CalibrationError

Axis = Literal["line", "sample"]

_ALONG: Final = 2.5  # bar widths from the middle to the end of three bars
_BESIDE: Final = 1.2  # of their length that is used: their ends are blurred


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


def find_bars(
    cube: str | Path, *, plane: Geometry | None = None, layout: Sequence[Element] | None = None
) -> list[Bars]:
    """Find the elements of a target in a cube of it.

    Args:
        cube: Of the target, scanned evenly.
        plane: The geometry as measured; the instrument file's by default.
        layout: Of the target; the groups -2 to 1 in columns by default.

    Raises:
        CalibrationError: The target is not found; see `scanhsi.calibration.usaf.place_target`.
    """
    picture = target_picture(cube)
    plane = plane or picture.plane
    layout = layout or columns()
    placed = place_target(picture.values, picture.steps, plane, layout)
    found: list[Bars] = []
    for element in layout:
        x, y = placed.middle(element)
        reach = (_BESIDE, _ALONG) if element.axis == "line" else (_ALONG, _BESIDE)
        right, up = (share * element.bar_mm for share in reach)
        steps = np.sort(plane.step_of([y - up, y + up]))
        lines = np.interp(steps, picture.steps, np.arange(len(picture.steps)), left=-1, right=len(picture.steps))
        samples = plane.sample_of(np.array([x - right, x + right]), plane.step_of(y))
        found.append(Bars(element.axis, element.bar_mm, _whole(lines), _whole(samples)))
    return found


def _whole(ends: NDArray[np.float64]) -> tuple[int, int]:
    first, last = np.rint(ends).astype(int).tolist()
    return first, last


def bars_from_cube(
    cube: str | Path,
    axis: Axis,
    elements: Sequence[Bars] | None = None,
    *,
    plane: Geometry | None = None,
    threshold: float = 0.2,
) -> BarContrast:
    """Contrast of the elements along one axis, widest bars first; those too fine for the pixels are left out.

    Args:
        cube: Of the target.
        axis: ``line`` along the scan, ``sample`` along the slit.
        elements: Where the bars are, those of the other axis are passed over; None finds them, see `find_bars`.
        plane: The geometry as measured; the instrument file's by default.
        threshold: Contrast that counts as resolved.

    Raises:
        CalibrationError: No element lies in the picture; see `bar_contrast`.
    """
    elements = find_bars(cube, plane=plane) if elements is None else elements
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
