"""Known lines fitted to a spectrum whose dispersion is roughly known: blends keep the distances that their wavelengths prescribe.

Lines that overlap at the instrument's resolution are one group with one common shift and one width, but a height for each: so 404.7
and 407.8 nm give a good place together, where two free Gaussians would trade height for distance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, cast

import numpy as np
from numpy.typing import NDArray

from scanhsi.calibration.dispersion import Dispersion
from scanhsi.calibration.lines import LineList
from scanhsi.calibration.peaks import FWHM_PER_SIGMA, noise_of

Floats = NDArray[np.float64]

_OVERLAP: Final = 2.7  # FWHM between neighbours of one group: farther ones do not reach into its window
_REACH: Final = 1.4  # FWHM to either side that a fit takes in
_WEAK: Final = 0.004  # of the highest line of its group: has no say
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
    """

    band: float
    band_sigma: float
    wavelength_nm: float
    fwhm: float
    fwhm_sigma: float
    shift: float


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
    spectrum: Floats, group: Group, fwhm: float, *, shift: float = 0.0, significance: float = 8.0
) -> Fitted | None:
    """Fit a group.

    Args:
        spectrum: (band,).
        group: As `group_lines` made it.
        fwhm: Roughly the width of a line, in bands.
        shift: Where to begin, in bands from where the group is expected.
        significance: Of the highest line, in standard deviations.

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
        solved = _solve(pixel, part, group.band[used], fwhm, shift) if used.any() else None
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
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Solved:
    heights: Floats
    shift: float
    shift_sigma: float
    fwhm: float
    fwhm_sigma: float
    noise: float


def _solve(pixel: Floats, part: Floats, bands: Floats, fwhm: float, shift: float) -> _Solved | None:
    """Gauss-Newton over the common shift and width; heights, level and slope of the background are linear."""
    freedom = len(part) - len(bands) - 4
    if freedom < 2:
        return None
    middle = pixel - pixel.mean()
    background = np.stack((np.ones_like(pixel), middle), axis=1)
    width, start = fwhm, shift
    design = np.hstack((_shapes(pixel, bands + shift, width)[0], background))
    heights = cast("Floats", np.linalg.lstsq(design, part, rcond=None)[0])[: len(bands)]
    for _ in range(_ITERATIONS):
        shapes, along, wider = _shapes(pixel, bands + shift, width)
        design = np.hstack((shapes, background, (along @ heights)[:, None], (wider @ heights)[:, None]))
        best = cast("Floats", np.linalg.lstsq(design, part, rcond=None)[0])
        heights = best[: len(bands)]
        move, grow = np.clip(best[-2:], -0.3 * fwhm, 0.3 * fwhm).tolist()
        shift, width = shift + move, float(np.clip(width + grow, 0.4 * fwhm, 2.5 * fwhm))
        if abs(shift - start) > 2 * fwhm:
            return None
        if abs(move) < 1e-6 and abs(grow) < 1e-5:
            break
    shapes, along, wider = _shapes(pixel, bands + shift, width)
    design = np.hstack((shapes, background, (along @ heights)[:, None], (wider @ heights)[:, None]))
    fitted = cast("Floats", np.linalg.lstsq(design[:, :-2], part, rcond=None)[0])
    variance = float(np.sum((part - design[:, :-2] @ fitted) ** 2)) / freedom
    spread = np.sqrt(np.diag(np.linalg.pinv(design.T @ design)) * variance)
    if not np.isfinite(spread).all() or not heights.max() > 0:
        return None
    return _Solved(fitted[: len(bands)], shift, float(spread[-2]), width, float(spread[-1]), math.sqrt(variance))


def _shapes(pixel: Floats, centre: Floats, fwhm: float) -> tuple[Floats, Floats, Floats]:
    """Lines of height 1, (pixel, line), and their derivatives by place and by width."""
    sigma = fwhm / FWHM_PER_SIGMA
    off = (pixel[:, None] - centre) / sigma
    shape = np.exp(-0.5 * off**2)
    return shape, shape * off / sigma, shape * off**2 / fwhm
