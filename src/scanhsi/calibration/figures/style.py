"""How figures of calibrations look: as wide as a page, colours that colour-blind readers tell apart, the source at the foot."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, cast

import matplotlib as mpl
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from scanhsi.calibration.result import Provenance
from scanhsi.devices.errors import CalibrationError

BLUE: Final = "#0072B2"
RED: Final = "#C1272D"
GREEN: Final = "#009E73"
ORANGE: Final = "#D55E00"
GREY: Final = "0.45"
WIDTH_IN: Final = 7.3

PAGE_STYLE: Final[dict[str, Any]] = {
    "font.size": 8,
    "axes.titlesize": 8.5,
    "axes.labelsize": 8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.7,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "0.9",
    "grid.linewidth": 0.6,
    "xtick.labelsize": 7.5,
    "ytick.labelsize": 7.5,
    "legend.frameon": False,
    "legend.fontsize": 7.5,
    "lines.linewidth": 1.3,
    "lines.markersize": 4,
    "image.cmap": "viridis",
    "image.interpolation": "nearest",
    "pdf.fonttype": 42,
}
_DPI: Final = 200


def save_figure(draw: Callable[[], Figure], path: Path, *more: Path) -> Path:
    """Draw once and write; the names' endings say how (.png, .pdf, .svg). Returns the first.

    Raises:
        CalibrationError: It cannot be written, or not so.
    """
    with mpl.rc_context(cast(Any, PAGE_STYLE)):  # its keys are typed as literals, from matplotlib 3.11 on
        figure = draw()
        for file in (path, *more):
            try:
                figure.savefig(file, dpi=_DPI)
            except (OSError, ValueError) as error:
                reason = getattr(error, "strerror", None) or error
                raise CalibrationError(f"cannot write {file}: {reason}.") from error
            figure.set_layout_engine("none")  # everything has its place now: finding it takes longer than drawing
    return path


def sheet(title: str, provenance: Provenance, *, height_in: float = 2.9) -> Figure:
    """An empty figure: heading above, where the data comes from at the foot."""
    figure = Figure(figsize=(WIDTH_IN, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    figure.set_layout_engine("constrained", rect=(0, 0, 1, 1 - 0.27 / height_in), w_pad=0.06)
    loud = "SIMULATED: " if provenance.simulated else ""
    figure.text(0.5, 1 - 0.06 / height_in, title, fontsize=9.5, fontweight="bold", ha="center", va="top")
    figure.supxlabel(f"{loud}{_told(provenance)}", fontsize=6, color=RED if loud else GREY)
    return figure


def _told(provenance: Provenance) -> str:
    conditions = provenance.conditions
    named = [source.rstrip("/").rpartition("/")[2] for source in provenance.sources]
    parts = named if len(named) == 1 else [f"{len(named)} sources"]
    if conditions.exposure_s is not None:
        parts.append(f"{1000 * conditions.exposure_s:g} ms")
    if conditions.gain_db is not None:
        parts.append(f"{conditions.gain_db:g} dB")
    if conditions.pixel_format is not None:
        parts.append(conditions.pixel_format)
    parts += [(provenance.taken or provenance.created)[:19].replace("T", " "), f"scanhsi {provenance.version}"]
    return ", ".join(parts)
