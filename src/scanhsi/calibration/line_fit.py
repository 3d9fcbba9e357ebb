"""Known lines fitted to a spectrum whose dispersion is roughly known: blends keep the distances that their wavelengths prescribe.

A narrow line is the image of the slit, a box, blurred by lens and pixel. With a wide slit it has a flat top, and a Gaussian
fitted to it is up to a tenth narrower than the line is at half its height: `SHAPES` are lines between Gaussian and box, of which
the one that fits best gives the width. Where a line lies is the same with all.

Lines that overlap at the instrument's resolution are one group with one common shift and one width, but a height for each: so 404.7
and 407.8 nm give a good place together, where two free Gaussians would trade height for distance.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, Final, cast

import numpy as np
from numpy.typing import NDArray
from scipy import interpolate, optimize
from scipy.special import ndtr

from scanhsi.calibration.dispersion import Dispersion
from scanhsi.calibration.lines import LineList
from scanhsi.calibration.peaks import FWHM_PER_SIGMA, noise_of

Floats = NDArray[np.float64]

_OVERLAP: Final = 2.7  # FWHM between neighbours of one group: farther ones do not reach into its window
_REACH: Final = 1.4  # FWHM to either side that a fit takes in
_WEAK: Final = 0.004  # of the highest line of its group: has no say
_FAR: Final = 4.0  # FWHM: a line ends here

GAUSSIAN: Final = 1 / FWHM_PER_SIGMA
SHAPES: Final = (GAUSSIAN, 0.36, 0.3, 0.24, 0.19, 0.15, 0.11, 0.08)
"""Standard deviation of the blur over the full width at half maximum of a line; what is missing of the width is the slit."""

Curve = Callable[[Floats], Floats]

_ITERATIONS: Final = 12
_FARTHEST: Final = 0.8  # FWHM a group may be from where it is expected


@dataclass(frozen=True, slots=True)
class Fitted:
    """A group of lines in a spectrum.

    Attributes:
        band, band_sigma: Where its mean wavelength lies, with standard error.
        wavelength_nm: Mean wavelength of the group by the heights found.
        fwhm, fwhm_sigma: Width of a single line, in bands, with standard error.
        shift: From where the dispersion expects it, in bands.
        misfit: Sum of the squares that the fit leaves, over the variance of the noise.
    """

    band: float
    band_sigma: float
    wavelength_nm: float
    fwhm: float
    fwhm_sigma: float
    shift: float
    misfit: float = math.nan


@dataclass(frozen=True, slots=True, eq=False)
class Group:
    """Lines that are fitted together.

    Attributes:
        wavelength_nm: Of each, (line,).
        band: Where the dispersion expects them, (line,).
    """

    wavelength_nm: Floats
    band: Floats


def group_lines(lines: LineList, dispersion: Dispersion, bands: int, fwhm: float) -> list[Group]:
    """Group the lines on the sensor by what overlaps, ``fwhm`` in bands; lines that no fit could tell apart become one."""
    inside: Floats = np.arange(bands, dtype=np.float64)
    wavelength = dispersion.nm(inside)
    order = np.argsort(wavelength)
    width_nm = fwhm * abs(float(dispersion.nm_per_band(bands / 2)))
    merged = lines.merged(0.15 * width_nm).within(float(wavelength.min()), float(wavelength.max()))
    place = np.interp(merged.wavelength_nm, wavelength[order], inside[order])
    by_place = np.argsort(place)
    place, known = place[by_place], merged.wavelength_nm[by_place]
    cuts = np.flatnonzero(np.diff(place) > _OVERLAP * fwhm) + 1
    parts = zip(np.split(known, cuts), np.split(place, cuts), strict=True)
    return [Group(nm, band) for nm, band in parts if len(band)]


def fit_group(
    spectrum: Floats,
    group: Group,
    fwhm: float,
    *,
    shift: float = 0.0,
    significance: float = 8.0,
    shape: float = GAUSSIAN,
) -> Fitted | None:
    """Fit a group.

    Args:
        spectrum: (band,).
        group: As `group_lines` made it.
        fwhm: Roughly the width of a line, in bands.
        shift: Where to begin, in bands from where the group is expected.
        significance: Of the highest line, in standard deviations.
        shape: One of `SHAPES`.

    Returns:
        None where the group does not show, is cut by the edge of the sensor, or looks otherwise.
    """
    low = math.floor(group.band[0] + shift - _REACH * fwhm)
    high = math.ceil(group.band[-1] + shift + _REACH * fwhm) + 1
    if low < 0 or high > len(spectrum):
        return None
    part: Floats = spectrum[low:high]
    if not np.isfinite(part).all():
        return None
    pixel: Floats = np.arange(low, high, dtype=np.float64)
    used, solved = np.ones(len(group.band), bool), None
    for _ in range(3):  # a line that is not there must not take part: weak ones go, and one looks at the rest
        solved = _solve(pixel, part, group.band[used], fwhm, shift, shape) if used.any() else None
        if solved is None:
            return None
        weak = solved.heights <= _WEAK * solved.heights.max()
        if not weak.any():
            break
        used[np.flatnonzero(used)[weak]] = False
    if solved is None or len(solved.heights) != used.sum():
        return None
    heights = solved.heights
    if not heights.max() > significance * max(solved.noise, noise_of(spectrum)):
        return None
    if abs(solved.shift - shift) > _FARTHEST * fwhm or not 0.5 < solved.fwhm / fwhm < 2:
        return None
    weights = np.maximum(heights, 0)
    place = float(np.average(group.band[used], weights=weights)) + solved.shift
    return Fitted(
        band=place,
        band_sigma=solved.shift_sigma,
        wavelength_nm=float(np.average(group.wavelength_nm[used], weights=weights)),
        fwhm=solved.fwhm,
        fwhm_sigma=solved.fwhm_sigma,
        shift=solved.shift,
        misfit=solved.squares / max(noise_of(spectrum) ** 2, 1e-24),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Solved:
    heights: Floats
    shift: float
    shift_sigma: float
    fwhm: float
    fwhm_sigma: float
    noise: float
    squares: float


def _solve(pixel: Floats, part: Floats, bands: Floats, fwhm: float, shift: float, shape: float) -> _Solved | None:
    """Gauss-Newton over the common shift and width; heights, level and slope of the background are linear."""
    freedom = len(part) - len(bands) - 4
    if freedom < 2:
        return None
    middle = pixel - pixel.mean()
    background = np.stack((np.ones_like(pixel), middle), axis=1)
    width, start = fwhm, shift
    design = np.hstack((_shapes(pixel, bands + shift, width, shape)[0], background))
    heights = cast("Floats", np.linalg.lstsq(design, part, rcond=None)[0])[: len(bands)]
    for _ in range(_ITERATIONS):
        shapes, along, wider = _shapes(pixel, bands + shift, width, shape)
        design = np.hstack((shapes, background, (along @ heights)[:, None], (wider @ heights)[:, None]))
        best = cast("Floats", np.linalg.lstsq(design, part, rcond=None)[0])
        heights = best[: len(bands)]
        move, grow = np.clip(best[-2:], -0.3 * fwhm, 0.3 * fwhm).tolist()
        shift, width = shift + move, float(np.clip(width + grow, 0.4 * fwhm, 2.5 * fwhm))
        if abs(shift - start) > 2 * fwhm:
            return None
        if abs(move) < 1e-6 and abs(grow) < 1e-5:
            break
    shapes, along, wider = _shapes(pixel, bands + shift, width, shape)
    design = np.hstack((shapes, background, (along @ heights)[:, None], (wider @ heights)[:, None]))
    fitted = cast("Floats", np.linalg.lstsq(design[:, :-2], part, rcond=None)[0])
    squares = float(np.sum((part - design[:, :-2] @ fitted) ** 2))
    variance = squares / freedom
    spread = np.sqrt(np.diag(np.linalg.pinv(design.T @ design)) * variance)
    if not np.isfinite(spread).all() or not heights.max() > 0:
        return None
    errors = float(spread[-2]), float(spread[-1])
    return _Solved(fitted[: len(bands)], shift, errors[0], width, errors[1], math.sqrt(variance), squares)


def _shapes(pixel: Floats, centre: Floats, fwhm: float, shape: float) -> tuple[Floats, Floats, Floats]:
    """Lines of height 1, (pixel, line), and their derivatives by place and by width."""
    line, slope = _curve(shape)
    off = np.clip((pixel[:, None] - centre) / fwhm, -_FAR, _FAR)
    falls = -slope(off) / fwhm
    return line(off), falls, falls * off


@cache
def _curve(sigma: float) -> tuple[Curve, Curve]:
    """A line of height and full width 1 around 0, and its slope: a Gaussian, and a box that makes it so wide."""
    place = np.linspace(-_FAR, _FAR, 4001)
    if sigma == GAUSSIAN:
        values = np.exp(-((place * FWHM_PER_SIGMA) ** 2) / 2)
    else:

        def half(box: float) -> float:
            return float(_blurred(0.5, box, sigma)) - 0.5

        values = _blurred(place, float(cast("Any", optimize.brentq(half, 1e-3, 1.0))), sigma)
    spline = interpolate.CubicSpline(place, values)
    return cast("tuple[Curve, Curve]", (spline, spline.derivative()))


def _blurred(place: Any, box: float, sigma: float) -> Any:
    return (ndtr((place + box / 2) / sigma) - ndtr((place - box / 2) / sigma)) / (2 * ndtr(box / 2 / sigma) - 1)
