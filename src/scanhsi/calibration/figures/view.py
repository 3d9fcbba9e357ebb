"""Figure 14 of the paper, of any cube: colours, one band, spectra."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from scanhsi.calibration.figures.style import BLUE, GREEN, ORANGE, RED, WIDTH_IN, save_figure, sheet
from scanhsi.calibration.view import View
from scanhsi.cube.spectra import RegionSpectrum

Extent = tuple[float, float, float, float]

_UNKNOWN: Final = 0.6
_SPECTRA_IN: Final = 2.1
_PAPER_ALPHA: Final = 0.01
_REGION_COLOURS: Final = (ORANGE, GREEN, "#8E6BBF", "#E69F00", "#56B4E9", RED)


def save_view(look: View, path: str | Path, *, title: str) -> Path:
    """Write a view; the name's ending says how (.png, .pdf, .svg). An older file is replaced.

    Args:
        look: What to draw.
        path: The file.
        title: Name of the cube. A simulated cube is marked as such at the foot.

    Raises:
        CalibrationError: It cannot be written, or not so.
    """
    return save_figure(lambda: draw_view(look, title), Path(path))


def draw_view(look: View, title: str) -> Figure:
    """Colours and a band above, spectra below, if there are any."""
    extent = _extent(look)
    left, right, bottom, top = extent
    aspect = abs(bottom - top) / abs(right - left)
    below = look.spectra is not None or bool(look.regions)
    above_in = float(np.clip(0.46 * WIDTH_IN * aspect + 0.55, 1.6, 5.2))
    height_in = above_in + 0.5 + below * _SPECTRA_IN
    figure = sheet(_heading(look, title), look.provenance, height_in=height_in)
    grid = figure.add_gridspec(1 + below, 2, height_ratios=(above_in, _SPECTRA_IN) if below else None)
    colour, band = (figure.add_subplot(grid[0, column]) for column in (0, 1))
    band.sharex(colour)
    band.sharey(colour)
    stretch = "equal" if 0.2 < aspect < 4 else "auto"
    _show_colour(colour, look, extent, stretch)
    _show_band(band, look, extent, stretch)
    for axes in (colour, band):
        axes.grid(visible=False)
        axes.spines[:].set_visible(False)
        _hatch(axes, look.missing, extent)
        for region, tint in zip(look.regions, _tints(look), strict=True):
            _outline(axes, region, look, extent, tint)
        axes.set_xlabel("sample" if look.extent_mm is None else "mm along the slit")
    colour.set_ylabel("line" if look.extent_mm is None else "mm along the scan")
    band.tick_params(labelleft=False)
    if look.extent_mm is not None:
        _ruler(band, extent)
    if below:
        _show_spectra(figure.add_subplot(grid[1, :]), look)
    return figure


def _extent(look: View) -> Extent:
    return look.extent_mm or (-0.5, look.samples - 0.5, len(look.missing) - 0.5, -0.5)


def _show_colour(axes: Axes, look: View, extent: Extent, stretch: Any) -> None:
    axes.imshow(np.nan_to_num(look.colour, nan=_UNKNOWN), extent=extent, aspect=stretch)
    axes.set_title(
        look.colour_note.replace("; ", "\n", 1) if len(look.colour_note) > 40 else look.colour_note, fontsize=7
    )


def _show_band(axes: Axes, look: View, extent: Extent, stretch: Any) -> None:
    low, high = look.band_range
    image = axes.imshow(
        np.ma.masked_invalid(look.band),
        cmap="gray",
        vmin=low,
        vmax=high,
        extent=extent,
        aspect=stretch,
    )
    axes.set_facecolor(str(_UNKNOWN))
    axes.set_title(look.band_name, fontsize=7)
    assert axes.figure is not None
    bar = axes.figure.colorbar(image, ax=axes, label=look.band_quantity, shrink=0.9, pad=0.02, aspect=30)
    bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue] the stubs take the outline for a list


def _ruler(axes: Axes, extent: Extent) -> None:
    """A bar of a round length in a corner of the picture, white on black, so that it shows on anything."""
    left, right, bottom, top = extent
    wide, high = abs(right - left), abs(bottom - top)
    length = max(
        size for size in (0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1e9) if size <= wide / 4 or size == 0.1
    )
    x = left + 0.05 * (right - left)
    y = bottom + 0.06 * (top - bottom)
    end = x + length * np.sign(right - left)
    axes.plot([x, end], [y, y], color="black", linewidth=4, solid_capstyle="butt")
    axes.plot([x, end], [y, y], color="white", linewidth=2.2, solid_capstyle="butt")
    box = {"facecolor": "black", "edgecolor": "none", "pad": 1, "alpha": 0.6}
    axes.text(
        (x + end) / 2,
        y + 0.035 * (top - bottom) * wide / high,
        f"{length:g} mm",
        color="white",
        fontsize=6.5,
        ha="center",
        bbox=box,
    )


def _hatch(axes: Axes, missing: NDArray[np.bool_], extent: Extent) -> None:
    """Missing lines are grey and hatched: nobody shall take them for something seen."""
    left, right, bottom, top = extent
    line = (bottom - top) / len(missing)
    edges = np.flatnonzero(np.diff(missing.astype(np.int8), prepend=0, append=0))
    for first, stop in edges.reshape(-1, 2):
        span = (top + first * line, top + stop * line)
        axes.fill_between([left, right], *span, facecolor=str(_UNKNOWN), edgecolor="0.3", hatch="////", linewidth=0)


def _outline(axes: Axes, region: RegionSpectrum, look: View, extent: Extent, tint: str) -> None:
    left, right, bottom, top = extent
    line, sample = (bottom - top) / len(look.missing), (right - left) / look.samples
    corner = (left + region.samples[0] * sample, top + region.lines[0] * line)
    size = ((region.samples[1] - region.samples[0]) * sample, (region.lines[1] - region.lines[0]) * line)
    axes.add_patch(Rectangle(corner, *size, fill=False, edgecolor="white", linewidth=2))
    axes.add_patch(Rectangle(corner, *size, fill=False, edgecolor=tint, linewidth=1.2))
    axes.plot(corner[0] + size[0] / 2, corner[1] + size[1] / 2, "+", color=tint, markersize=5)


def _tints(look: View) -> list[str]:
    return [_REGION_COLOURS[number % len(_REGION_COLOURS)] for number in range(len(look.regions))]


def _show_spectra(axes: Axes, look: View) -> None:
    place = np.arange(len(_any_spectrum(look)), dtype=np.float64) if look.wavelength_nm is None else look.wavelength_nm
    handles: list[Line2D] = []
    if look.spectra is not None:
        values = look.spectra.values
        # The paper's 1/100 is for thick lines; here so that a tenth of the spectra on one place are nearly opaque.
        alpha = float(np.clip(15 / len(values), 2 * _PAPER_ALPHA, 0.5))
        axes.plot(place, values.T, color=BLUE, alpha=alpha, linewidth=0.6)
        handles.append(Line2D([], [], color=BLUE, alpha=0.5, linewidth=0.8, label=f"{len(values)} random pixels"))
        known = np.isfinite(values).any(axis=0)
        median = np.full(len(place), np.nan)
        median[known] = np.nanmedian(values[:, known], axis=0)
        handles += axes.plot(place, median, color="black", linewidth=1.3, label="their median")
        axes.set_ylim(*_limits(values))
    for region, tint in zip(look.regions, _tints(look), strict=True):
        axes.fill_between(
            place, region.mean - region.sigma, region.mean + region.sigma, color=tint, alpha=0.2, linewidth=0
        )
        handles += axes.plot(place, region.mean, color=tint, linewidth=1.2, label=_told(region))
    axes.set_xlim(float(place.min()), float(place.max()))
    axes.set_xlabel("band" if look.wavelength_nm is None else "wavelength / nm")
    axes.set_ylabel(look.quantity)
    axes.legend(
        handles=handles,
        ncols=3,
        fontsize=6.5,
        columnspacing=1.2,
        loc="lower right",
        bbox_to_anchor=(1, 1),
        borderaxespad=0.2,
    )


def _any_spectrum(look: View) -> NDArray[np.float64]:
    return look.spectra.values[0] if look.spectra is not None else look.regions[0].mean


def _limits(values: NDArray[np.float64]) -> tuple[float, float]:
    """Of the axis: where nearly all numbers are; where there is hardly any light, reflectance is wild."""
    known = values[np.isfinite(values)]
    low, high = np.percentile(known, [0.5, 99.5])
    spare = 0.08 * max(float(high - low), 1e-3)
    return min(0.0, float(low) - spare), float(high) + spare


def _told(region: RegionSpectrum) -> str:
    def span(name: str, ends: tuple[int, int]) -> str:
        return f"{name} {ends[0]}" if ends[1] - ends[0] == 1 else f"{name}s {ends[0]}:{ends[1]}"

    spread = "" if region.count.max() < 2 else r", mean $\pm\,\sigma$"
    return f"{span('line', region.lines)}, {span('sample', region.samples)}{spread}"


def _heading(look: View, title: str) -> str:
    lost = int(look.missing.sum())
    text = f"{title}: {len(look.missing) - lost} of {look.lines_planned} lines"
    return text + (f", {lost} missing" if lost else "")
