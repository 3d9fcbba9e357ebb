"""Shapes to draw scenes with, on a grid of the object plane: depths of capsules, curves, bumps, noise, light."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from scanhsi_sim.filters import blur, distance

Floats = NDArray[np.floating[Any]]
Points = list[tuple[float, float]]
Joint = tuple[float, float, float]
"""x, y and radius, in mm."""
Window = tuple[slice, slice]

PITCH_MM = 0.25
X_MM = (-160.0, 160.0)
Y_MM = (-150.0, 150.0)


@dataclass(frozen=True)
class Grid:
    """Places of the points of a map, in mm: x a row, y a column that falls, as it does with the lines of a scan."""

    x: Floats
    y: Floats

    @classmethod
    def whole(cls) -> Grid:
        """The whole object plane."""
        x = np.arange(round((X_MM[1] - X_MM[0]) / PITCH_MM) + 1, dtype=np.float32) * np.float32(PITCH_MM) + np.float32(
            X_MM[0]
        )
        y = np.float32(Y_MM[1]) - np.arange(round((Y_MM[1] - Y_MM[0]) / PITCH_MM) + 1, dtype=np.float32) * np.float32(
            PITCH_MM
        )
        return cls(x[None, :], y[:, None])

    @property
    def shape(self) -> tuple[int, int]:
        """Of a map: (y, x)."""
        return self.y.shape[0], self.x.shape[1]

    def near(self, x: float, y: float, reach_mm: float) -> tuple[Window, Grid]:
        """The window of the map around a place, and its grid: small things need not be drawn on all of it."""
        row, column = (Y_MM[1] - y) / PITCH_MM, (x - X_MM[0]) / PITCH_MM
        reach = reach_mm / PITCH_MM
        rows = slice(max(round(row - reach), 0), max(round(row + reach), 0))
        columns = slice(max(round(column - reach), 0), max(round(column + reach), 0))
        return (rows, columns), Grid(self.x[:, columns], self.y[rows])


def capsule(grid: Grid, a: Joint, b: Joint) -> Floats:
    """How deep a point lies in a capsule whose radius goes from a's to b's, in mm; negative outside."""
    dx, dy = b[0] - a[0], b[1] - a[1]
    along = np.clip(((grid.x - a[0]) * dx + (grid.y - a[1]) * dy) / (dx * dx + dy * dy), 0, 1)
    away = np.hypot(grid.x - a[0] - along * dx, grid.y - a[1] - along * dy)
    return a[2] + along * (b[2] - a[2]) - away


def merge(parts: list[Floats], softness_mm: float) -> Floats:
    """Union of depths with rounded inner corners (a smooth maximum)."""
    top = np.max(parts, axis=0)
    total = np.zeros_like(top)
    for part in parts:
        total += np.exp((part - top) / softness_mm)
    return top + softness_mm * np.log(total)


def chain(grid: Grid, joints: list[Joint]) -> Floats:
    """Depth in a chain of capsules."""
    return merge([capsule(grid, a, b) for a, b in itertools.pairwise(joints)], 0.6)


def stroke(grid: Grid, points: Points, radius_mm: float) -> tuple[Window, Floats]:
    """A smooth line through points with a Gaussian profile of height 1, and the window of the map it is in."""
    knots = np.asarray(points, float)
    length = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(knots, axis=0).T))])
    curve = CubicSpline(length, knots)(np.arange(0, length[-1], PITCH_MM))
    column = np.rint((curve[:, 0] - X_MM[0]) / PITCH_MM).astype(int)
    row = np.rint((Y_MM[1] - curve[:, 1]) / PITCH_MM).astype(int).clip(0, grid.shape[0] - 1)
    margin = round(4 * radius_mm / PITCH_MM)
    top, left = max(int(row.min()) - margin, 0), max(int(column.min()) - margin, 0)
    bottom, right = min(int(row.max()) + margin, grid.shape[0]), int(column.max()) + margin
    paper = np.ones((bottom - top, right - left), bool)
    paper[row - top, column - left] = False
    away = distance(paper) * np.float32(PITCH_MM)
    return (slice(top, bottom), slice(left, right)), np.exp(-((away / np.float32(radius_mm)) ** 2))


def spot(target: Floats, grid: Grid, place: tuple[float, float], size_mm: float, height: float) -> None:
    """Add a round Gaussian bump to a map."""
    window, here = grid.near(*place, 3 * size_mm)
    target[window] += np.float32(height) * np.exp(-((here.x - place[0]) ** 2 + (here.y - place[1]) ** 2) / size_mm**2)


def noise(shape: tuple[int, int], size_mm: float, rng: np.random.Generator) -> Floats:
    """Smooth noise of about unit variance with features of a size."""
    coarse = max(1, int(size_mm / PITCH_MM / 3))
    small = rng.standard_normal((shape[0] // coarse + 2, shape[1] // coarse + 2), np.float32)
    smooth = blur(small, max(size_mm / PITCH_MM / coarse / 2, 0.5))
    wide = np.repeat(np.repeat(smooth / smooth.std(), coarse, 0), coarse, 1)[: shape[0], : shape[1]]
    return blur(wide, coarse / 2) if coarse > 1 else wide


def facing(slope_x: Floats, slope_y: Floats, towards: tuple[float, float, float]) -> Floats:
    """Cosine between the normal of a relief and a direction, 0 where it faces away."""
    upright = towards[2] - towards[0] * slope_x - towards[1] * slope_y
    return np.clip(upright / np.sqrt(1 + slope_x**2 + slope_y**2), 0, 1)
