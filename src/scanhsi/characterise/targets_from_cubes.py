"""Geometry and resolution from cubes of printed targets: grid, slanted edge."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, Literal, cast

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from scanhsi.calibration.geometry import Geometry, Turn, fit_geometry, number_grid
from scanhsi.calibration.resolution import EdgeResponse, edge_response
from scanhsi.characterise.from_cubes import opened, provenance_of
from scanhsi.characterise.picture import TargetPicture, target_picture
from scanhsi.devices.errors import CalibrationError

Floats = NDArray[np.float64]
Path_ = str | Path

_PROMINENT: Final = 0.3
_AROUND: Final = 0.3  # of the distance of grid lines: what belongs to one
_EDGE_HALF: Final = 32
_SHIFT: Final = 16  # pixels that a slanted edge moves over the rows used
_SHARE: Final = 0.5  # of the rows: the square that the edge belongs to has corners


def geometry_from_cube(
    cube: Path_, *, pitch_mm: float = 6.0, fit_tilt: bool = False, origin_known: bool = True, turn: Turn = None
) -> Geometry:
    """Distance, normal step and sample pitch from a grid of dark lines (figure 7).

    Args:
        cube: Of the grid, its lines along slit and scan; the instrument file's distance has to be right to 5 %.
        pitch_mm: Of the grid.
        fit_tilt: Fit the tilt of the plane, too.
        origin_known: A grid line lies at the foot of the normal; see `fit_geometry`.
        turn: Steps of a turn of a shaft out of true, which is fitted too; ``"find"`` looks for it.

    Raises:
        CalibrationError: No grid; see `fit_geometry`.
    """
    picture = target_picture(cube)
    places = grid_lines(picture.values, axis=0)
    steps = np.interp(places, np.arange(len(picture.steps)), picture.steps)
    start = replace(picture.plane, sample_pitch_mm=_sample_pitch(picture, pitch_mm))
    y_mm = number_grid(steps, start, pitch_mm) * pitch_mm
    return fit_geometry(steps, y_mm, start, picture.provenance, fit_tilt=fit_tilt, origin_known=origin_known, turn=turn)


def _sample_pitch(picture: TargetPicture, pitch_mm: float) -> float:
    """From the lines across the slit near the normal, where the view is not magnified."""
    near = np.abs(picture.plane.gamma_rad(picture.steps)) < math.radians(3)
    if near.sum() < 8:
        return picture.plane.sample_pitch_mm
    places = grid_lines(picture.values[near], axis=1)
    if len(places) < 3:
        return picture.plane.sample_pitch_mm
    spacing = float(np.median(places[1:] - places[:-1]))
    number = np.rint((places - places[0]) / spacing)
    number, places = number - number.mean(), places - places.mean()
    return pitch_mm * float(np.sum(number**2) / np.sum(number * places))


def grid_lines(values: Floats, axis: int) -> Floats:
    """Where dark lines cross an axis of a picture, in pixels with fractions.

    Lines along the axis itself hide in a median across it; each crossing is the centroid of its darkness.

    Args:
        values: (line, sample).
        axis: 0: crossings along the scan; 1: along the slit.

    Raises:
        CalibrationError: Fewer than three lines stand out.
    """
    across = 1 - axis
    even = values / np.maximum(
        np.quantile(values, 0.9, axis=axis, keepdims=True), 1e-9
    )  # uneven light across is no line
    profile = np.median(even, axis=across)
    bright = np.quantile(profile, 0.9)
    depth = np.clip(1 - profile / bright, 0, None)
    found = cast("Any", signal.find_peaks(np.pad(depth, 1), prominence=_PROMINENT * float(depth.max())))
    peaks = np.asarray(found[0], np.int64) - 1
    if len(peaks) < 3 or depth.max() < 0.05:
        raise CalibrationError(
            f"{len(peaks)} lines of a grid stand out {'along the scan' if axis == 0 else 'along the slit'}; three are needed.",
            hint="is the grid in view, in focus, and its lines along slit and scan?",
        )
    reach = max(2, int(_AROUND * float(np.median(np.diff(peaks)))))
    inside = [peak for peak in peaks.tolist() if reach <= peak < len(depth) - reach]
    return np.array([_centroid(depth, peak, reach) for peak in _apart(inside, depth, 2 * reach)])


def _apart(peaks: list[int], depth: Floats, least: int) -> list[int]:
    """The deepest peak of each line: jitter can split one."""
    kept: list[int] = []
    for peak in peaks:
        if kept and peak - kept[-1] < least:
            if depth[peak] > depth[kept[-1]]:
                kept[-1] = peak
        else:
            kept.append(peak)
    return kept


def _centroid(depth: Floats, peak: int, reach: int) -> float:
    window = slice(peak - reach, peak + reach + 1)
    place = np.arange(window.start, window.stop, dtype=np.float64)
    weight = np.clip(depth[window] - 0.1 * depth[peak], 0, None)
    return float(np.sum(weight * place) / np.sum(weight))


def edge_from_cubes(
    cubes: Sequence[Path_], axis: Literal["line", "sample"], *, plane: Geometry | None = None, slant_deg: float = 5.0
) -> EdgeResponse:
    """Modulation transfer across the strongest edge along an axis (figure 11), from the mean of scans of the same steps.

    Along the scan an edge lies in some fifteen lines, whose jitter alone decides how sharp it looks: with 0.2 mm one scan is
    wrong by a sixth, and too sharp on average since the edge is laid through these lines. Every further scan has its own jitter.

    Args:
        cubes: Of a slanted edge that did not move.
        axis: ``line`` along the scan, ``sample`` along the slit.
        plane: The geometry as measured; the instrument file's by default.
        slant_deg: Of the edge, roughly.

    Raises:
        CalibrationError: No cubes, or of other steps, or no edge; see `edge_response`.
    """
    picture = _mean_picture(cubes)
    plane = plane or picture.plane
    stride = abs(float(np.median(np.diff(picture.steps))))
    pitches = float(plane.line_pitch_mm(plane.normal_step)) * stride, plane.sample_pitch_mm
    along, across = pitches if axis == "line" else pitches[::-1]
    rows = int(_SHIFT / (math.tan(math.radians(slant_deg)) * across / along))
    part, line = _around_edge(
        picture.values,
        0 if axis == "line" else 1,
        min(rows, int(_SHARE * picture.values.shape[1 if axis == "line" else 0])),
    )
    there = float(picture.steps[line])
    here = plane.line_pitch_mm(there) * stride if axis == "line" else plane.x_mm(plane.principal_sample + 1, there)
    return edge_response(part, axis, float(here), picture.provenance, across_mm=across)


def _mean_picture(cubes: Sequence[Path_]) -> TargetPicture:
    pictures = [target_picture(cube) for cube in cubes]
    if not pictures or any(not np.array_equal(one.steps, pictures[0].steps) for one in pictures):
        raise CalibrationError("one or several scans of the same steps are needed.")
    values = np.mean([one.values for one in pictures], axis=0)
    return replace(pictures[0], values=values, provenance=provenance_of(opened(cubes), cubes))


def _around_edge(values: Floats, axis: int, rows: int) -> tuple[Floats, int]:
    """The neighbourhood of the strongest edge along an axis, and the line in the middle of it."""
    turned = values.T if axis == 0 else values  # (across, along)
    centre = len(turned) // 2
    middle = slice(max(0, centre - rows // 2), centre + rows // 2)
    profile = turned[middle].mean(axis=0)
    if len(profile) < 2 * _EDGE_HALF + 20:
        raise CalibrationError(f"an edge needs {2 * _EDGE_HALF + 20} pixels on its axis, not {len(profile)}.")
    smooth = np.convolve(profile, np.ones(_SHIFT) / _SHIFT, mode="valid")
    slope = np.abs(smooth[_SHIFT:] - smooth[:-_SHIFT])  # of the steps around place index + _SHIFT - 1/2
    first = max(0, _EDGE_HALF - _SHIFT)
    place = int(np.argmax(slope[first : len(slope) - first])) + first + _SHIFT
    part = turned[middle, max(0, place - _EDGE_HALF) : place + _EDGE_HALF]
    return (part.T if axis == 0 else part), place if axis == 0 else centre
