"""Figures 4 and 7 of the paper: what a rotating mirror makes of a plane, and the grid that tells it."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from scanhsi.calibration.figures.style import BLUE, GREY, ORANGE, sheet
from scanhsi.calibration.geometry import Geometry

Floats = NDArray[np.float64]

_SAMPLES: Final = 1200
_GRID: Final = 25
_FAR: Final = 1.6  # of the linear range


def draw_distortion(plane: Geometry) -> Figure:
    """Figure 4: the places in the object plane that an even grid of pixels looks at, and that grid."""
    figure = sheet(f"What the mirror sees of a plane at {plane.distance_mm:.1f} mm", plane.provenance, height_in=3.6)
    left, right = figure.subplots(1, 2)
    linear = plane.linear_range()
    roi = plane.provenance.conditions.roi or {}
    samples = int(roi.get("samples", _SAMPLES))
    step = np.linspace(plane.normal_step - _FAR * linear.steps, plane.normal_step + _FAR * linear.steps, 2 * _GRID + 1)
    sample = np.linspace(0, samples - 1, _GRID)
    x = plane.x_mm(sample[None, :], step[:, None])
    y = np.broadcast_to(plane.y_mm(step)[:, None], x.shape)
    inside = np.abs(plane.gamma_rad(step)) <= linear.gamma_rad + 1e-9
    for keep, colour, label in ((inside, BLUE, "within the linear range"), (~inside, ORANGE, "beyond")):
        left.plot(x[keep].ravel(), y[keep].ravel(), ".", color=colour, markersize=2, label=label)
        columns, rows = np.meshgrid(sample, step[keep])
        right.plot(columns.ravel(), rows.ravel(), ".", color=colour, markersize=2)
    left.set_xlabel("along the slit / mm")
    left.set_ylabel("along the scan / mm")
    left.set_title("object plane")
    left.legend(loc="upper center", ncols=2, fontsize=6.5, bbox_to_anchor=(0.5, -0.16), markerscale=2.5)
    right.set_xlabel("sample")
    right.set_ylabel("mirror step")
    right.set_title("pixels")
    for axes in (left, right):
        axes.margins(0.04)
    if plane.y_mm(step[-1]) < 0:
        right.invert_yaxis()
    return figure


def draw_grid(plane: Geometry, step: ArrayLike, y_mm: ArrayLike, pitch_mm: float) -> Figure:
    """Figure 7: where the lines of a grid were found, with the model, and what it leaves.

    Args:
        plane: Fitted to the grid.
        step: Of the lines, with fractions, (line,).
        y_mm: Of the lines on the target, (line,).
        pitch_mm: Of the grid.
    """
    found, known = np.asarray(step, np.float64), np.asarray(y_mm, np.float64)
    title = f"Grid of {pitch_mm:g} mm: distance {plane.distance_mm:.2f} $\\pm$ {plane.distance_sigma_mm:.2f} mm"
    figure = sheet(title, plane.provenance, height_in=2.7)
    left, middle, right = figure.subplots(1, 3)
    angle = np.degrees(plane.gamma_rad(found))
    many: Floats = np.linspace(float(found.min()), float(found.max()), 300)
    degrees = np.degrees(plane.gamma_rad(many))
    left.plot(degrees, plane.y_mm(many), color=ORANGE, label=r"$-r\,\tan\gamma$")
    left.plot(degrees, -plane.distance_mm * np.radians(degrees), ":", color=GREY, label=r"$-r\,\gamma$")
    left.plot(angle, known, "o", color=BLUE, markersize=3, label="lines of the grid")
    left.set_ylabel("y / mm")
    left.legend()
    width = np.abs(np.diff(found))
    between = (angle[1:] + angle[:-1]) / 2
    middle.plot(between, width, "o", color=BLUE, markersize=3)
    middle.plot(degrees, pitch_mm / plane.line_pitch_mm(many), color=ORANGE)
    middle.set_ylabel("cell of the grid / steps")
    even = replace(plane, turn_steps=math.nan)
    right.axhline(0, color=GREY, linewidth=0.8)
    right.plot(angle, known - even.y_mm(found), "o", color=BLUE, markersize=3)
    words = [f"$\\sigma$ = {plane.residual_mm:.2f} mm"] if math.isfinite(plane.residual_mm) else []
    if math.isfinite(plane.turn_steps):
        right.plot(degrees, plane.y_mm(many) - even.y_mm(many), color=ORANGE, linewidth=1)
        words.append(f"around a shaft out of true,\n{plane.turn_steps:.0f} steps a turn")
    right.set_title(" ".join(words), fontsize=7)
    right.set_ylabel("grid less model / mm")
    for axes in (left, middle, right):
        axes.set_xlabel(r"optical angle $\gamma$ / degrees")
    return figure
