"""Figures 9 and 10 of the paper: what told the wavelengths, and how close lines may be."""

from __future__ import annotations

from itertools import pairwise
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from scanhsi.calibration.figures.style import BLUE, GREEN, ORANGE, sheet
from scanhsi.calibration.lines import LineList
from scanhsi.calibration.wavelength import Wavelength

Floats = NDArray[np.float64]

_CLOSE_UPS: Final = ((720.0, 840.0), (530.0, 600.0))
_SPECIES: Final = {"Hg": BLUE, "Ar": ORANGE}
_NAMED: Final = 0.02  # of the tallest: lines below are not named
_SAME_NM: Final = 0.2
_NEAR_NM: Final = 10.0
_DIP: Final = 0.02
_LABEL_IN: Final = 0.095


def draw_tile(result: Wavelength, reflectance: Floats) -> Figure:
    """Figure 9: absorption of a wavelength standard before and after calibration, and the polynomial.

    Args:
        result: Of the tile.
        reflectance: Of the tile, (band,); nan where it is not known.
    """
    figure = sheet(f"Wavelengths from {result.source.rpartition('/')[2]}", result.provenance, height_in=3.9)
    grid = figure.add_gridspec(2, 2, width_ratios=(1.7, 1))
    above, below = figure.add_subplot(grid[0, 0]), figure.add_subplot(grid[1, 0])
    right = figure.add_subplot(grid[:, 1])
    band = np.arange(result.bands)
    known = np.isfinite(reflectance)
    low, high = (float(value) for value in np.quantile(reflectance[known], [0.002, 0.998]))
    span = high - low
    for axes, place in ((above, band.astype(np.float64)), (below, result.nm())):
        axes.plot(place, reflectance, color=BLUE, linewidth=0.9)
        axes.set_ylim(low - 0.08 * span, high + (0.6 if axes is above else 0.12) * span)
        axes.set_xlim(float(place[known].min()), float(place[known].max()))
        axes.set_ylabel("reflectance")
    levels = np.interp(result.line_band, band[known], reflectance[known])
    above.plot(result.line_band, levels, "o", color=ORANGE, markersize=3)
    ends = above.get_xlim()
    spots = _spread(result.line_band, _LABEL_IN * (ends[1] - ends[0]) / 3.9, *ends)
    for spot, place, level, nm in zip(spots, result.line_band, levels, result.line_nm, strict=True):
        path = [place, place, spot, spot], [level, high + 0.05 * span, high + 0.12 * span, high + 0.15 * span]
        above.plot(*path, color=ORANGE, linewidth=0.5)
        above.text(
            spot, high + 0.17 * span, f"{nm:.1f}", rotation=90, fontsize=5.8, ha="center", va="bottom", color=ORANGE
        )
    above.set_xlabel("band")
    above.set_title("minima as they were found, with their wavelengths in nm")
    below.vlines(result.line_nm, low, high + 0.1 * span, color=ORANGE, linewidth=0.8, linestyle=":")
    below.set_xlabel("wavelength / nm")
    below.set_title("calibrated; dotted: the certificate's minima")
    right.plot(band, result.nm(), color=BLUE)
    right.plot(result.line_band, result.line_nm, "o", color=ORANGE, markersize=3.5)
    right.set_xlabel("band")
    right.set_ylabel("wavelength / nm")
    right.set_title(f"degree {len(result.coefficients) - 1}: {result.residual_nm:.2f} nm rms")
    return figure


def draw_lamp(result: Wavelength, counts: Floats, lines: LineList) -> Figure:
    """Figure 10: the spectrum of a lamp with the names of its lines, and close-ups of those that are close to each other.

    Args:
        result: Of the lamp.
        counts: Of the lamp, (band,), dark signal subtracted.
        lines: Of the lamp.
    """
    middle = float(np.mean(result.nm([0, result.bands - 1])))
    fwhm = float(result.fwhm_nm(middle))
    figure = sheet(f"Lines of {lines.name}: {fwhm:.2f} nm wide at {middle:.0f} nm", result.provenance, height_in=4.6)
    grid = figure.add_gridspec(2, 2, height_ratios=(1.25, 1))
    nm, level = result.nm(), counts / np.nanmax(counts)
    named = lines.calibrating().merged(_SAME_NM)
    _spectrum(figure.add_subplot(grid[0, :]), nm, level, named, (float(nm.min()), float(nm.max())), wide_in=6.6)
    for number, (low, high) in enumerate(_CLOSE_UPS):
        here = (nm >= low) & (nm <= high)
        if here.sum() > 3 and np.isfinite(level[here]).any():
            axes = figure.add_subplot(grid[1, number])
            _spectrum(axes, nm, level, named, (low, high), wide_in=2.9)
            axes.set_title(_resolved(named.within(low, high), nm, level), fontsize=7)
    return figure


def _spectrum(
    axes: Axes, nm: Floats, level: Floats, lines: LineList, ends: tuple[float, float], *, wide_in: float
) -> None:
    """A part of the spectrum with its lines; their names in a row above it."""
    low, high = ends
    here = (nm >= low) & (nm <= high)
    axes.plot(nm[here], level[here], color="black", linewidth=0.8)
    tall = float(np.nanmax(level[here]))
    axes.set_ylim(-0.03 * tall, 1.6 * tall)
    axes.set_xlim(low, high)
    shown = lines.within(max(low, float(nm.min())), min(high, float(nm.max())))
    heights = np.array([_level_at(nm, level, line) for line in shown.wavelength_nm.tolist()])
    keep = heights > _NAMED * tall
    tints = [_tint(name) for name, kept in zip(shown.species, keep.tolist(), strict=True) if kept]
    _name(axes, shown.wavelength_nm[keep], heights[keep], tints, wide_in)
    axes.set_yticks([tick for tick in MaxNLocator(4).tick_values(0, tall) if 0 <= tick <= 1.05 * tall])
    axes.set_xlabel("wavelength / nm")
    axes.set_ylabel("signal / largest")


def _name(axes: Axes, places: Floats, heights: Floats, tints: list[str], wide_in: float) -> None:
    """Wavelengths of some peaks, upright in a row above all of them, moved aside where they would lie on each other."""
    low, high = axes.get_xlim()
    tall = axes.get_ylim()[1] / 1.6
    spots = _spread(places, _LABEL_IN * (high - low) / wide_in, low, high)
    for place, height, spot, tint in zip(places.tolist(), heights.tolist(), spots.tolist(), tints, strict=True):
        path = [place, place, spot, spot], [height + 0.02 * tall, 1.06 * tall, 1.18 * tall, 1.22 * tall]
        axes.plot(*path, color=tint, linewidth=0.5)
        axes.text(spot, 1.24 * tall, f"{place:.1f}", rotation=90, fontsize=5.8, ha="center", va="bottom", color=tint)


def _level_at(nm: Floats, level: Floats, line: float) -> float:
    value = float(np.interp(line, nm, level))
    return value if np.isfinite(value) else 0.0


def _tint(species: str) -> str:
    return _SPECIES.get(species.partition(" ")[0], GREEN)


def _resolved(lines: LineList, nm: Floats, level: Floats) -> str:
    """The closest lines that a dip tells apart, and the most distant ones that none does."""
    pairs = [pair for pair in pairwise(lines.wavelength_nm.tolist()) if pair[1] - pair[0] < _NEAR_NM]
    apart = [pair for pair in pairs if _dip(nm, level, *pair) > _DIP]
    blended = [pair for pair in pairs if _dip(nm, level, *pair) <= _DIP]
    words: list[str] = []
    if apart:
        words.append("{:.1f}, {:.1f} nm told apart".format(*min(apart, key=_gap)))
    if blended:
        words.append("{:.1f}, {:.1f} nm not".format(*max(blended, key=_gap)) + ("" if apart else " told apart"))
    return "; ".join(words)


def _gap(pair: tuple[float, float]) -> float:
    return pair[1] - pair[0]


def _dip(nm: Floats, level: Floats, left: float, right: float) -> float:
    """How far the signal falls between two lines, of the lower of them; 0 where it does not."""
    lower = min(_level_at(nm, level, left), _level_at(nm, level, right))
    between = level[(nm > left) & (nm < right)]
    if lower <= 0 or not np.isfinite(between).any():
        return 0.0
    return 1 - float(np.nanmin(between)) / lower


def _spread(places: Floats, apart: float, low: float, high: float) -> Floats:
    """Rising places at least so far apart, each as near as may be to where it was: what is too close shares its middle."""
    groups: list[tuple[float, list[float]]] = []
    for place in places.tolist():
        start, members = place, [place]
        while groups and groups[-1][0] + apart * len(groups[-1][1]) > start:
            members = [*groups.pop()[1], *members]
            start = sum(members) / len(members) - apart * (len(members) - 1) / 2
            start = min(max(start, low), high - apart * (len(members) - 1))
        groups.append((start, members))
    return np.array([start + apart * number for start, members in groups for number in range(len(members))])
