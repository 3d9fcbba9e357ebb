"""The USAF 1951 target: elements of three bars as MIL-STD-150A has them, groups -2 to 1, laid out in columns.

An element of ``f = 2^(group + (element - 1) / 6)`` line pairs a mm has bars of width ``w = 1 / (2 f)``, length ``5 w`` and gaps of
``w``, once upright and once lying: two squares of ``5 w``. Where the standard nests the groups, here each group is a column.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np

from scanhsi_sim.effects import TargetOptions
from scanhsi_sim.scenes.edges import Blur, Floats, Footprint

GROUPS = range(-2, 2)
ELEMENTS = range(1, 7)


@dataclass(frozen=True, slots=True)
class Element:
    """One element, in mm from the centre of the target, before it is moved or turned.

    Attributes:
        group, element: Its numbers.
        bar_mm: Width of a bar.
        upright: Middle of the square whose bars follow each other along the slit (x).
        lying: Middle of the square whose bars follow each other along the scan (y).
    """

    group: int
    element: int
    bar_mm: float
    upright: tuple[float, float]
    lying: tuple[float, float]


@cache
def usaf_elements() -> tuple[Element, ...]:
    """All elements, widest bars first."""
    columns = [[0.5 * 2.0 ** -(group + (element - 1) / 6) for element in ELEMENTS] for group in GROUPS]
    left = -sum(14 * column[0] for column in columns) / 2
    found: list[Element] = []
    for group, column in zip(GROUPS, columns, strict=True):
        top = sum(7 * width for width in column) / 2
        for element, width in zip(ELEMENTS, column, strict=True):
            y = top - 3.5 * width
            upright, lying = (left + 3.5 * column[0], y), (left + 10.5 * column[0], y)
            found.append(Element(group, element, width, upright, lying))
            top -= 7 * width
        left += 14 * column[0]
    return tuple(found)


def usaf(foot: Footprint, options: TargetOptions) -> Floats:
    """Black bars on white."""
    turn = math.radians(options.turn_deg)
    (u, blur_u), (v, blur_v) = (foot.across(angle, options.centre_mm) for angle in (turn, turn + math.pi / 2))
    black = np.zeros(len(foot.x))
    for element in usaf_elements():
        for middle, wide in ((element.upright, element.bar_mm), (element.lying, 5 * element.bar_mm)):
            lying = wide > element.bar_mm
            reach = 2.5 * element.bar_mm
            near = _near(u - middle[0], v - middle[1], reach + blur_u.reach, reach + blur_v.reach)
            if near is not None:
                across, along = (v, u) if lying else (u, v)
                blurs = (blur_v, blur_u) if lying else (blur_u, blur_v)
                place = middle[::-1] if lying else middle
                black[near] += _bars(across[near] - place[0], along[near] - place[1], blurs, element.bar_mm)
    return black


def _near(u: Floats, v: Floats, reach_u: float, reach_v: float) -> slice | None:
    """The samples, in one piece, that see a square around (0, 0); None where none does."""
    inside = np.flatnonzero((np.abs(u) < reach_u) & (np.abs(v) < reach_v))
    return slice(int(inside[0]), int(inside[-1]) + 1) if inside.size else None


def _bars(across: Floats, along: Floats, blurs: tuple[Blur, Blur], width: float) -> Floats:
    """Three bars around (0, 0)."""
    stripes = [blurs[0].stripe(across + shift * width, width) for shift in (-2, 0, 2)]
    return np.sum(stripes, axis=0) * blurs[1].stripe(along, 5 * width)
