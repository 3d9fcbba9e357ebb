"""What figures of the paper show beside a result: the spectra, grid lines and pictures in the cubes that it was made from."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from scanhsi.calibration.dark import DarkModel
from scanhsi.calibration.figures.bars import Profile
from scanhsi.calibration.geometry import Geometry
from scanhsi.calibration.result import Result
from scanhsi.characterise.bars_from_cube import Bars, find_bars
from scanhsi.characterise.lit_from_cubes import lit_frames
from scanhsi.characterise.picture import target_picture
from scanhsi.characterise.targets_from_cubes import grid_lines
from scanhsi.devices.errors import CalibrationError

Floats = NDArray[np.float64]

_SAMPLES: Final = 100
_WHITE: Final = "white"
_PITCH_MM: Final = 0.1


def sources_of(result: Result, path: Path) -> list[Path]:
    """The cubes that a result was made from, wherever its folder has been moved to.

    Args:
        result: That was stored.
        path: Its file.

    Raises:
        CalibrationError: One is not there any more.
    """
    return [_found(Path(source), path) for source in result.provenance.sources]


def _found(source: Path, path: Path) -> Path:
    for place in (source, path.parent / source.parent.name / source.name, path.parent / source.name):
        if place.is_dir():
            return place
    raise CalibrationError(f"its cube {source} is not there any more.", hint=f"put it beside {path}")


def middle_spectra(cubes: list[Path], dark: DarkModel | None) -> dict[str, Floats]:
    """Spectra in the middle of the slit, less the dark signal, by what the cubes say they are of.

    Args:
        cubes: Of things lit, and dark ones of the same exposure.
        dark: Dark model, for cubes without dark ones.

    Returns:
        (band,) each, nan where saturated.

    Raises:
        CalibrationError: There is no dark signal for them.
    """
    return {name: _middle(frame) for name, frame in lit_frames(cubes, dark).frames.items()}


def _middle(frame: Floats) -> Floats:
    """Median of the samples in the middle, of the bands that most of them know."""
    middle = frame.shape[1] // 2
    some = frame[:, max(0, middle - _SAMPLES // 2) : middle + _SAMPLES // 2]
    known = np.isfinite(some).mean(axis=1) > 0.5
    spectrum = np.full(len(some), np.nan)
    spectrum[known] = np.nanmedian(some[known], axis=1)
    return spectrum


def tile_reflectance(spectra: dict[str, Floats]) -> Floats:
    """Reflectance of a tile beside a white one, (band,); nan where there is hardly any light.

    Raises:
        CalibrationError: One of the two is missing.
    """
    others = [name for name in spectra if name != _WHITE]
    if _WHITE not in spectra or len(others) != 1:
        raise CalibrationError(f"a cube of the tile and one of a white tile are needed, not of {', '.join(spectra)}.")
    white = spectra[_WHITE]
    lit = white > 0.02 * np.nanmax(white)
    return np.where(lit, spectra[others[0]] / np.where(lit, white, 1.0), np.nan)


@dataclass(frozen=True, slots=True, eq=False)
class GridPoints:
    """Lines of a grid as they were found.

    Attributes:
        step: Mirror step that looks at each, with fractions, (line,).
        y_mm: Where it lies on the target, (line,).
        pitch_mm: Of the grid.
    """

    step: Floats
    y_mm: Floats
    pitch_mm: float


def grid_points(cube: Path, plane: Geometry) -> GridPoints:
    """Lines of a grid in a cube, told by the geometry that was fitted to it.

    Raises:
        CalibrationError: No grid.
    """
    picture = target_picture(cube)
    step = np.interp(grid_lines(picture.values, axis=0), np.arange(len(picture.steps)), picture.steps)
    y = plane.y_mm(step)
    pitch = _PITCH_MM * round(float(np.median(np.abs(y[1:] - y[:-1]))) / _PITCH_MM)
    pitch = round(pitch) if abs(pitch - round(pitch)) < 2.5 * _PITCH_MM else pitch  # printed grids are of whole mm
    return GridPoints(step, np.rint(y / pitch) * pitch, pitch)


@dataclass(frozen=True, slots=True, eq=False)
class BarTarget:
    """A bar target as it was seen.

    Attributes:
        picture: From 0, black, to 1, white, (line, sample).
        extent_mm: Left, right, bottom, top.
        profiles: Of the elements.
        lacks: Why there are none of them; empty where there are.
    """

    picture: Floats
    extent_mm: tuple[float, float, float, float]
    profiles: list[Profile]
    lacks: str = ""


def bar_target(cube: Path, elements: list[Bars] | None, plane: Geometry | None) -> BarTarget:
    """A cube of a bar target with cross-sections of its elements.

    Args:
        cube: Of the target.
        elements: Where its bars are, those outside of the picture are left out; None finds them, if it can.
        plane: Geometry as measured; the instrument file's by default.

    Raises:
        CalibrationError: It is no picture.
    """
    seen = target_picture(cube)
    plane = seen.plane if plane is None else replace(plane, principal_sample=seen.plane.principal_sample)
    black, white = (float(level) for level in np.quantile(seen.values, [0.005, 0.9]))
    picture = (seen.values - black) / max(white - black, 1e-9)
    x, y = plane.x_mm(np.arange(picture.shape[1], dtype=np.float64), plane.normal_step), plane.y_mm(seen.steps)
    lacks = ""
    try:
        elements = find_bars(cube, plane=plane) if elements is None else elements
    except CalibrationError as error:
        elements, lacks = [], " ".join(str(error).split())
    profiles = [
        _profile(picture, one, x if one.axis == "sample" else y)
        for one in elements
        if min(*one.lines, *one.samples) >= 0 and one.lines[1] < len(y) and one.samples[1] < len(x)
    ]
    return BarTarget(picture, (float(x[0]), float(x[-1]), float(y[-1]), float(y[0])), profiles, lacks)


def _profile(picture: Floats, one: Bars, place: Floats) -> Profile:
    lines, samples = (slice(first, last + 1) for first, last in (one.lines, one.samples))
    along = samples if one.axis == "sample" else lines
    there = place[along]
    values = picture[lines, samples].mean(axis=0 if one.axis == "sample" else 1)
    return Profile(one.axis, one.bar_mm, there - there.mean(), values)
