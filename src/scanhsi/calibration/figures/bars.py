"""Figure 11 of the paper: a bar target, cross-sections of some of its bars, and their contrast along both axes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from scanhsi.calibration.figures.style import GREEN, GREY, RED, sheet
from scanhsi.calibration.resolution import BarContrast

Floats = NDArray[np.float64]

_LOOK: Final = {"line": (RED, "along the scan"), "sample": (GREEN, "along the slit")}
_WIDTHS_MM: Final = (2.0, 1.0, 0.5)


@dataclass(frozen=True, slots=True, eq=False)
class Profile:
    """Cross-section of three bars.

    Attributes:
        axis: Along which they follow each other.
        bar_mm: Width of one.
        place_mm: Of its pixels along the axis, from the middle, (pixel,).
        reflectance: From 0, black, to 1, white, (pixel,).
    """

    axis: str
    bar_mm: float
    place_mm: Floats
    reflectance: Floats


def draw_bar_target(
    results: Sequence[BarContrast],
    picture: Floats | None,
    extent_mm: tuple[float, float, float, float] | None,
    profiles: Sequence[Profile] = (),
) -> Figure:
    """Draw it.

    Args:
        results: Contrast along one axis or both.
        picture: From 0, black, to 1, white, (line, sample); None leaves it out.
        extent_mm: Left, right, bottom, top of the picture.
        profiles: Of bars; those of 2, 1 and 0.5 mm, or the nearest to them, are shown.
    """
    worst = max((result.resolved_mm for result in results), default=float("nan"))
    said = f": bars of {worst:.2g} mm resolved along both axes" if len(results) == 2 and np.isfinite(worst) else ""
    chosen = _chosen(profiles)
    wide = picture is not None and extent_mm is not None
    figure = sheet(f"USAF 1951{said}", results[0].provenance, height_in=4.4 if wide else 2.9)
    columns = [1.2, 1] if wide else [1]
    grid = figure.add_gridspec(len(chosen) + 2, len(columns), width_ratios=columns)
    if wide:
        assert picture is not None
        _picture(figure.add_subplot(grid[:, 0]), picture, extent_mm)
    for number, width in enumerate(chosen):
        axes = figure.add_subplot(grid[number, -1])
        _sections(axes, [one for one in profiles if one.bar_mm == width], width)
        if number == 0:
            axes.legend(fontsize=6, ncols=2, loc="lower center", bbox_to_anchor=(0.5, 1.0), borderaxespad=0.1)
    contrasts = figure.add_subplot(grid[len(chosen) :, -1])
    _contrasts(contrasts, results)
    if not chosen:
        contrasts.legend(fontsize=6.5, loc="lower right")
    return figure


def _picture(axes: Axes, picture: Floats, extent_mm: tuple[float, float, float, float] | None) -> None:
    axes.imshow(picture, cmap="gray", vmin=0, vmax=1.05, extent=extent_mm, aspect="equal", interpolation="antialiased")
    rows = np.flatnonzero((picture < 0.5).any(axis=1))
    columns = np.flatnonzero((picture < 0.5).any(axis=0))
    if extent_mm is not None and rows.size and columns.size:
        left, right, bottom, top = extent_mm
        x = left + (right - left) * (columns[[0, -1]] + 0.5) / picture.shape[1]
        y = top + (bottom - top) * (rows[[-1, 0]] + 0.5) / picture.shape[0]
        spare = 0.04 * max(abs(float(x[1] - x[0])), abs(float(y[1] - y[0])))
        axes.set_xlim(float(x.min()) - spare, float(x.max()) + spare)
        axes.set_ylim(float(y.min()) - spare, float(y.max()) + spare)
    axes.grid(visible=False)
    axes.set_xlabel("along the slit / mm")
    axes.set_ylabel("along the scan / mm")


def _chosen(profiles: Sequence[Profile]) -> list[float]:
    """Widths that both axes have, if they have any, nearest to those of the paper."""
    of = {axis: {one.bar_mm for one in profiles if one.axis == axis} for axis in _LOOK}
    there = sorted(of["line"] & of["sample"] or of["line"] | of["sample"])
    nearest = (min(there, key=lambda width: abs(np.log(width / wanted))) for wanted in _WIDTHS_MM if there)
    return list(dict.fromkeys(nearest))


def _sections(axes: Axes, profiles: Sequence[Profile], width: float) -> None:
    for one in profiles:
        colour, label = _LOOK[one.axis]
        axes.plot(one.place_mm / width, one.reflectance, color=colour, linewidth=1, label=label)
    axes.set_ylim(-0.15, 1.2)
    axes.set_xticks([-2, -1, 0, 1, 2])
    axes.set_yticks([0, 1])
    axes.set_xlabel(f"place / {width:.2g} mm, the width of a bar", fontsize=6.5, labelpad=1)


def _contrasts(axes: Axes, results: Sequence[BarContrast]) -> None:
    for result in results:
        colour, label = _LOOK[result.axis]
        axes.semilogx(result.bar_mm, result.contrast, "o-", color=colour, markersize=2.5, linewidth=1, label=label)
        if np.isfinite(result.resolved_mm):
            axes.axvline(result.resolved_mm, color=colour, linestyle=":", linewidth=0.9)
    axes.axhline(results[0].threshold, color=GREY, linestyle=":", linewidth=0.9)
    widths = np.concatenate([result.bar_mm for result in results])
    ticks = [tick for tick in (0.1, 0.2, 0.3, 0.5, 1, 2, 3, 5) if widths.min() <= tick <= widths.max()]
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.set_xticks([], minor=True)
    axes.set_ylim(0, 1.1)
    axes.set_xlabel("width of a bar / mm")
    axes.set_yticks([0, 0.5, 1])
    axes.set_ylabel("contrast")
