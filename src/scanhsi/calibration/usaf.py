"""Where the elements of a USAF 1951 target lie in a picture: a drawing of the target is laid over it.

The picture is brought to an even grid in mm by the geometry of the object plane, so only a shift and a turn are left. Both are
those at which drawing and picture correlate best: the turn is tried, the shift comes from a Fourier transform. Large bars decide,
so it works on pictures in which the fine ones are not resolved; those are where the drawing has them.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal, cast

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

from scanhsi.calibration.geometry import Geometry
from scanhsi.devices.errors import CalibrationError

Floats = NDArray[np.float64]
Axis = Literal["line", "sample"]

_TURNS_DEG: Final = np.arange(-6.0, 6.01, 1.0)
_FINER: Final = (0.5, 0.25, 0.125)
_ALIKE: Final = 0.5  # correlation of a target with its drawing: another one has 0.3 at most
_BEYOND: Final = 0.2  # of the picture's size
_MARGIN_MM: Final = 2.0
_LEAST: Final = 32
_LARGEST: Final = 4096  # pixels of a side


@dataclass(frozen=True, slots=True)
class Element:
    """Three bars on the target, each five times as long as wide, with gaps of their width: a square.

    Attributes:
        axis: Along which they follow each other, where the target lies straight.
        bar_mm: Width of a bar.
        x_mm, y_mm: Middle of the square on the target; x along the slit, y upwards.
    """

    axis: str
    bar_mm: float
    x_mm: float
    y_mm: float


def columns(groups: Sequence[int] = (-2, -1, 0, 1)) -> tuple[Element, ...]:
    """A target whose groups stand side by side, each a column of its six elements, upright bars left of lying ones.

    The bars are those of MIL-STD-150A: ``1 / 2^(1 + group + (element - 1) / 6)`` mm wide. The standard nests the groups; of a
    target that does, give the places: `load_layout`.
    """
    widths = {group: [2.0 ** -(1 + group + number / 6) for number in range(6)] for group in groups}
    left = -7 * sum(column[0] for column in widths.values())
    found: list[Element] = []
    for column in widths.values():
        top = 3.5 * sum(column)
        for width in column:
            places = (("sample", left + 3.5 * column[0]), ("line", left + 10.5 * column[0]))
            found += [Element(axis, width, x, top - 3.5 * width) for axis, x in places]
            top -= 7 * width
        left += 14 * column[0]
    return tuple(found)


def load_layout(path: str | Path) -> tuple[Element, ...]:
    """Read where a target has its elements: a CSV file with the columns ``axis``, ``bar_mm``, ``x_mm``, ``y_mm``.

    Raises:
        CalibrationError: It cannot be read, or a column is missing or no number.
    """
    try:
        with Path(path).open(newline="", encoding="utf-8") as file:
            found = tuple(
                Element(row["axis"].strip(), float(row["bar_mm"]), float(row["x_mm"]), float(row["y_mm"]))
                for row in csv.DictReader(file)
            )
    except (OSError, KeyError, ValueError, AttributeError, TypeError) as error:
        raise CalibrationError(f"{path} is no layout of a target: {error!r}.") from error
    if wrong := sorted({one.axis for one in found} - {"line", "sample"}):
        raise CalibrationError(f"{path}: {', '.join(wrong)} is no axis; line and sample are.")
    return found


@dataclass(frozen=True, slots=True)
class Placed:
    """A target found in a picture.

    Attributes:
        x_mm, y_mm: Its centre in the object plane.
        turn_deg: By which it is turned, from the slit towards the scan.
        correlation: Of picture and drawing where the target is, 1 at most.
    """

    x_mm: float
    y_mm: float
    turn_deg: float
    correlation: float

    def middle(self, element: Element) -> tuple[float, float]:
        """Middle of an element in the object plane, x and y in mm."""
        cosine, sine = math.cos(math.radians(self.turn_deg)), math.sin(math.radians(self.turn_deg))
        return (
            self.x_mm + cosine * element.x_mm - sine * element.y_mm,
            self.y_mm + sine * element.x_mm + cosine * element.y_mm,
        )


def place_target(picture: Floats, steps: Floats, plane: Geometry, layout: Sequence[Element]) -> Placed:
    """Find a target of black bars on white in a picture.

    Args:
        picture: (line, sample), bright where white.
        steps: Mirror steps of the lines, rising, (line,).
        plane: Geometry of the object plane, right to some percent.
        layout: Of the target.

    Raises:
        CalibrationError: No layout, a picture too small or with values that are no numbers, or no such target in it.
    """
    values = np.asarray(picture, np.float64)
    if not layout:
        raise CalibrationError("the layout has no elements.")
    if values.ndim != 2 or min(values.shape) < _LEAST or not np.isfinite(values).all():
        raise CalibrationError(
            f"a picture of {_LEAST} lines and samples at least is needed, all known: {values.shape}."
        )
    pitch = _pitch(steps, plane)
    dark, corner = _even(values, np.asarray(steps, np.float64), plane, pitch)
    if not np.ptp(dark) > 1e-6:
        raise CalibrationError("nothing varies over the picture: saturated, or no light.")
    margin = round(_BEYOND * max(dark.shape))  # some of the target may lie outside of the picture
    dark = np.pad(dark, margin)
    corner = corner[0] - margin * pitch, corner[1] + margin * pitch
    wide = [element for element in layout if element.bar_mm >= pitch]
    seen = cast("Any", fft.rfft2(dark))
    tried = {float(turn): _match(dark, seen, wide, float(turn), pitch) for turn in _TURNS_DEG}
    for finer in _FINER:
        best = max(tried, key=lambda turn: tried[turn][0])
        tried |= {best + step: _match(dark, seen, wide, best + step, pitch) for step in (-finer, finer)}
    turn = max(tried, key=lambda turn: tried[turn][0])
    correlation, row, column = tried[turn]
    if correlation < _ALIKE:
        raise CalibrationError(
            f"no target of this layout is in the picture: what is most like it correlates by {correlation:.2f}.",
            hint="is it in view as a whole, turned by less than 6 degrees, and the geometry measured?",
        )
    return Placed(corner[0] + pitch * column, corner[1] - pitch * row, turn, correlation)


def _pitch(steps: Floats, plane: Geometry) -> float:
    """The coarser of lines and samples, halved: nothing gets lost."""
    lines = float(plane.line_pitch_mm(plane.normal_step)) * abs(float(np.median(np.diff(steps))))
    return max(lines, plane.sample_pitch_mm) / 2


def _even(values: Floats, steps: Floats, plane: Geometry, pitch: float) -> tuple[Floats, tuple[float, float]]:
    """Darkness on an even grid, y falling with the row, 0 where white; and x and y of its first pixel."""
    ends = plane.y_mm(steps[[0, -1]])
    reach = plane.x_mm(np.array([0.0, values.shape[1] - 1.0]), plane.normal_step)
    y = np.arange(float(ends.max()), float(ends.min()), -pitch)
    x = np.arange(float(reach.min()), float(reach.max()), pitch)
    if max(len(x), len(y)) > _LARGEST:
        raise CalibrationError(f"a target is looked for in {_LARGEST} pixels at most, not {len(y)} x {len(x)}.")
    seen = plane.step_of(y)
    line = np.interp(seen, steps, np.arange(len(steps)))
    sample = plane.sample_of(x[None, :], seen[:, None])
    places = np.stack((np.broadcast_to(line[:, None], sample.shape), sample))
    there = cast("Floats", ndimage.map_coordinates(values, places, order=1, mode="nearest"))
    white = float(np.quantile(there, 0.95))
    return np.clip(1 - there / max(white, 1e-9), 0, 1), (float(x[0]), float(y[0]))


def _match(
    dark: Floats, seen: Any, layout: Sequence[Element], turn_deg: float, pitch: float
) -> tuple[float, float, float]:
    """Best correlation of the picture with the target turned so, and row and column of its centre, with fractions.

    ``seen`` is the picture's Fourier transform.
    """
    drawing, there = _drawing(layout, turn_deg, pitch)
    if any(drawn > here for drawn, here in zip(drawing.shape, dark.shape, strict=True)):
        drawing, there = _cut(drawing, dark.shape, there)
    shape = dark.shape
    even = drawing - drawing.mean()
    spectrum = np.conj(cast("Any", fft.rfft2(even, shape)))
    product = cast("Floats", fft.irfft2(seen * spectrum, shape))
    level, power = (_sums(part, drawing.shape) for part in (dark, dark**2))
    spread = np.sqrt(np.maximum(power - level**2 / drawing.size, 1e-12 * drawing.size))
    inside = product[: spread.shape[0], : spread.shape[1]] / (spread * math.sqrt(float(np.sum(even**2))))
    row, column = (int(place) for place in np.unravel_index(int(np.argmax(inside)), inside.shape))
    return (
        float(inside[row, column]),
        row + _top(inside[:, column], row) + there[0],
        column + _top(inside[row], column) + there[1],
    )


def _sums(values: Floats, box: tuple[int, ...]) -> Floats:
    """Sums over all boxes of a size that lie within."""
    total = np.pad(values, ((1, 0), (1, 0))).cumsum(axis=0).cumsum(axis=1)
    rows = total[box[0] :] - total[: -box[0]]
    return rows[:, box[1] :] - rows[:, : -box[1]]


def _top(values: Floats, at: int) -> float:
    """Where between its neighbours the largest value would be, by a parabola."""
    if not 0 < at < len(values) - 1:
        return 0.0
    before, here, after = values[at - 1 : at + 2].tolist()
    bend = before - 2 * here + after
    return float(np.clip((before - after) / (2 * bend), -0.5, 0.5)) if bend < 0 else 0.0


def _drawing(layout: Sequence[Element], turn_deg: float, pitch: float) -> tuple[Floats, tuple[float, float]]:
    """The turned target in black, and row and column of its centre."""
    placed = Placed(0.0, 0.0, turn_deg, 1.0)
    middles = [placed.middle(element) for element in layout]
    reach = [3.6 * element.bar_mm + _MARGIN_MM for element in layout]
    right, up = (max(abs(place[side]) + far for place, far in zip(middles, reach, strict=True)) for side in (0, 1))
    columns, rows = round(right / pitch), round(up / pitch)
    drawing = np.zeros((2 * rows + 1, 2 * columns + 1))
    cosine, sine = math.cos(math.radians(turn_deg)), math.sin(math.radians(turn_deg))
    for element, (x, y) in zip(layout, middles, strict=True):
        size = math.ceil(3.6 * element.bar_mm / pitch)
        row, column = round(-y / pitch) + rows, round(x / pitch) + columns
        down, across = np.mgrid[row - size : row + size + 1, column - size : column + size + 1]
        dx, dy = (across - columns) * pitch - x, -(down - rows) * pitch - y
        u, v = cosine * dx + sine * dy, cosine * dy - sine * dx
        along, beside = (u, v) if element.axis == "sample" else (v, u)
        stripes = sum(_covered(along - 2 * k * element.bar_mm, element.bar_mm, pitch) for k in (-1, 0, 1))
        drawing[down, across] += stripes * _covered(beside, 5 * element.bar_mm, pitch)
    return np.clip(drawing, 0, 1), (float(rows), float(columns))


def _covered(place: Floats, width: float, pitch: float) -> Floats:
    """Share of a pixel that lies on a stripe around 0."""
    return np.clip((width / 2 - np.abs(place)) / pitch + 0.5, 0, 1)


def _cut(drawing: Floats, shape: tuple[int, ...], there: tuple[float, float]) -> tuple[Floats, tuple[float, float]]:
    """The middle of a drawing that is larger than the picture: what sticks out is white, or not in view."""
    low = [max(0, (drawn - seen) // 2) for drawn, seen in zip(drawing.shape, shape, strict=True)]
    part = drawing[low[0] : low[0] + shape[0], low[1] : low[1] + shape[1]]
    return part, (there[0] - low[0], there[1] - low[1])
