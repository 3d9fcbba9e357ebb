"""Quicklooks as PNG files: the colour picture and the band picture side by side."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from scanhsi.calibration.quicklook import Quicklook
from scanhsi.devices.errors import CubeError

_WIDTH_IN: Final = 12.0
_DPI: Final = 120

Extent = tuple[float, float, float, float]


def save_picture(look: Quicklook, path: str | Path, *, title: str) -> None:
    """Write a quicklook as a PNG file, replacing an older one.

    Args:
        look: What to draw.
        path: The file.
        title: Name of the cube. A simulated cube is marked as such beside it.

    Raises:
        CubeError: The file cannot be written.
    """
    png = io.BytesIO()
    _draw(look, title).savefig(png, format="png", dpi=_DPI)
    try:
        Path(path).write_bytes(png.getvalue())
    except OSError as error:
        raise CubeError(f"cannot write {path}: {error.strerror or error}.") from error


def _draw(look: Quicklook, title: str) -> Figure:
    lines = len(look.missing)
    left, right, bottom, top = extent = look.extent_mm or (-0.5, look.samples - 0.5, lines - 0.5, -0.5)
    aspect = abs(bottom - top) / abs(right - left)
    figure = Figure(figsize=(_WIDTH_IN, float(np.clip(5.1 * aspect + 1.1, 3.2, 14))), layout="constrained")
    FigureCanvasAgg(figure)
    colour, band = figure.subplots(1, 2, sharex=True, sharey=True)
    stretch = "equal" if 0.2 < aspect < 4 else "auto"
    colour.imshow(np.nan_to_num(look.colour, nan=0.6), extent=extent, aspect=stretch)
    colour.set_title(look.colour_note, fontsize=8)
    low, high = np.nanpercentile(look.band, [1, 99.5])
    image = band.imshow(
        look.band,
        cmap="gray",
        vmin=low,
        vmax=max(high, low + (1 if look.quantity == "counts" else 1e-3)),
        extent=extent,
        aspect=stretch,
    )
    band.set_title(look.band_name, fontsize=8)
    figure.colorbar(image, ax=band, label=look.quantity, shrink=0.8)
    for axes in (colour, band):
        _hatch(axes, look.missing, extent)
        axes.set_xlabel("sample" if look.extent_mm is None else "mm along the slit")
    colour.set_ylabel("line" if look.extent_mm is None else "mm along the scan")
    figure.suptitle(_heading(look, title), fontsize=11, color="firebrick" if look.simulated else "black")
    return figure


def _heading(look: Quicklook, title: str) -> str:
    lost = int(look.missing.sum())
    text = f"{title}: {len(look.missing) - lost} of {look.lines_planned} lines"
    return ("SIMULATED  " if look.simulated else "") + text + (f", {lost} missing" if lost else "")


def _hatch(axes: Axes, missing: np.ndarray[tuple[int], np.dtype[np.bool_]], extent: Extent) -> None:
    """Missing lines are grey and hatched: nobody shall take them for something seen."""
    left, right, bottom, top = extent
    line = (bottom - top) / len(missing)
    edges = np.flatnonzero(np.diff(missing.astype(np.int8), prepend=0, append=0))
    for first, stop in edges.reshape(-1, 2):
        span = (top + first * line, top + stop * line)
        axes.fill_between([left, right], *span, facecolor="0.6", edgecolor="0.3", hatch="////", linewidth=0)
