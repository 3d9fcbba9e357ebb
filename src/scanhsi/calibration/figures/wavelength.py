"""Figures of what the spectrograph bends: smile and keystone."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure

from scanhsi.calibration.figures.style import BLUE, GREEN, ORANGE, sheet
from scanhsi.calibration.keystone import Keystone
from scanhsi.calibration.smile import Smile

_COLOURS: Final = (BLUE, GREEN, ORANGE)


def draw_smile(result: Smile) -> Figure:
    """Lines along the slit with the fit, what is left, and the resolution over sensor and slit."""
    figure = sheet(f"Smile: {result.largest_bands:.2f} bands at most", result.provenance)
    left, middle, right = figure.subplots(1, 3)
    sample = np.arange(result.samples)
    shown = np.linspace(0, len(result.line_nm) - 1, 3).round().astype(int).tolist()
    for line, colour in zip(shown, _COLOURS, strict=False):
        place = float(np.nanmedian(result.line_band[line]))
        fitted = result.shift(place, sample)
        own = result.line_band[line] - np.nanmedian(result.line_band[line] - result.shift(place, result.block))
        left.plot(result.block, own, ".", color=colour, markersize=3)
        left.plot(sample, fitted, color=colour, linewidth=1, label=f"{result.line_nm[line]:.0f} nm")
        middle.plot(result.block, 1000 * (own - result.shift(place, result.block)), ".", color=colour, markersize=3)
    left.set_ylabel("shift / bands")
    left.legend()
    middle.set_ylabel("line less fit / (band / 1000)")
    picture = right.pcolormesh(result.block, result.line_nm, result.line_fwhm_nm, shading="nearest")
    figure.colorbar(picture, ax=right, label="width of a line (FWHM) / nm")
    right.set_ylabel("wavelength / nm")
    right.grid(visible=False)
    for axes in (left, middle, right):
        axes.set_xlabel("sample")
    return figure


def draw_keystone(result: Keystone) -> Figure:
    """Places along the slit over the bands with the fit, and the map of the shift."""
    figure = sheet(f"Keystone: {result.largest_samples:.2f} samples at most", result.provenance)
    left, right = figure.subplots(1, 2)
    band = np.arange(result.bands)
    shown = np.linspace(0, len(result.sample) - 1, 3).round().astype(int).tolist()
    for piece, colour in zip(shown, _COLOURS, strict=False):
        place = float(result.sample[piece])
        left.plot(result.band, result.moved[:, piece], ".", color=colour, markersize=3)
        left.plot(band, result.shift(band, place), color=colour, linewidth=1, label=f"sample {place:.0f}")
    left.set_xlabel("band")
    left.set_ylabel("shift / samples")
    left.legend()
    rows, columns = np.linspace(0, result.bands - 1, 80), np.linspace(0, result.samples - 1, 80)
    picture = right.pcolormesh(columns, rows, result.shift(rows[:, None], columns[None, :]), shading="nearest")
    figure.colorbar(picture, ax=right, label="shift / samples")
    right.set_xlabel("sample")
    right.set_ylabel("band")
    right.grid(visible=False)
    return figure


FIGURES: Final[dict[str, Callable[[Any], Figure]]] = {Smile.kind: draw_smile, Keystone.kind: draw_keystone}
