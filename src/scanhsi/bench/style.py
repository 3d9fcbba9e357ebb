"""How figures look: as wide as a page, in colours that colour-blind readers can tell apart, and with their source at the foot."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final, cast

import matplotlib as mpl
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullLocator, StrMethodFormatter

from scanhsi.calibration.figures.style import PAGE_STYLE
from scanhsi.devices.errors import CubeError

STAGE_COLOURS: Final = {
    "exposure": "#0072B2",
    "move": "#8E6BBF",
    "transfer": "#009E73",
    "copy": "#D55E00",
    "store": "#E69F00",
    "waiting": "#B0B0B0",
}
SCENARIO_COLOURS: Final = {"full": "#C1272D", "static": "#0072B2", "acquire": "#009E73"}
SCENARIO_MARKERS: Final = {"full": "o", "static": "s", "acquire": "^"}
CONTINUOUS_COLOUR: Final = "#8E6BBF"
FORMAT_COLOURS: Final = {"Mono8": "#0072B2", "Mono12Packed": "#D55E00", "Mono12": "#333333", "Mono16": "#8E6BBF"}
FORMAT_MARKERS: Final = {"Mono8": "o", "Mono12Packed": "s", "Mono12": "^", "Mono16": "D"}
FORMAT_TITLES: Final = {
    "Mono8": "8 bit",
    "Mono12Packed": "12 bit packed",
    "Mono12": "12 bit unpacked",
    "Mono16": "16 bit",
}
IDEAL: Final[dict[str, Any]] = {"color": "0.35", "linestyle": ":", "linewidth": 1.2}

_STYLE: Final[dict[str, Any]] = {**PAGE_STYLE, "hatch.linewidth": 0.7}
_DPI: Final = 200


def save(draw: Callable[[], Figure], folder: Path, name: str) -> list[Path]:
    """Draw a figure and write it as PNG and as PDF, replacing older ones.

    Raises:
        CubeError: The files cannot be written.
    """
    paths = [folder / f"{name}.png", folder / f"{name}.pdf"]
    with mpl.rc_context(cast(Any, _STYLE)):  # its keys are typed as literals, from matplotlib 3.11 on
        figure = draw()
        try:
            for path in paths:
                figure.savefig(path, dpi=_DPI)
                figure.set_layout_engine("none")  # everything has its place now
        except OSError as error:
            raise CubeError(f"cannot write {folder / name}: {error.strerror or error}.") from error
    return paths


def canvas(width_in: float, height_in: float, *, title: str, source: str, legend: Sequence[Artist] = ()) -> Figure:
    """An empty figure: heading and legend above, where the data comes from at the foot."""
    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    head_in = 0.5 if legend else 0.26
    figure.set_layout_engine("constrained", rect=(0, 0, 1, 1 - head_in / height_in))
    figure.text(0.5, 1 - 0.05 / height_in, title, fontsize=9.5, fontweight="bold", ha="center", va="top")
    if legend:
        anchor = (0.5, 1 - 0.2 / height_in)
        figure.legend(handles=legend, loc="upper center", bbox_to_anchor=anchor, ncols=len(legend), columnspacing=1.4)
    figure.supxlabel(source, fontsize=6, color="0.4")
    return figure


def exposure_axis(axes: Axes, exposures_ms: list[float]) -> None:
    """A logarithmic axis of exposures with ticks where people look."""
    low, high = min(exposures_ms), max(exposures_ms)
    axes.set_xscale("log")
    axes.set_xlim(low / 1.12, high * 1.12)
    usual = [10**decade * digit for decade in range(-3, 5) for digit in (1, 2, 5)]
    axes.xaxis.set_major_locator(FixedLocator([tick for tick in usual if low / 1.1 <= tick <= high * 1.1]))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))


def source_of(facts: dict[str, Any]) -> str:
    """Where a session's data comes from, in a line or two."""
    devices, git = facts["devices"], facts["git"]
    time = "virtual time" if facts["virtual_time"] else "real time"
    parts = [f"{facts['command']}", time, f"scanhsi {facts['versions']['scanhsi']}"]
    if git:
        parts.append(f"commit {git['commit'][:10]}{' (changed)' if git['changed'] else ''}")
    parts.append(facts["started"])
    what = f"{devices['camera']['model']}, {devices['camera']['firmware']}"
    return f"{'SIMULATED: ' if facts['simulated'] else ''}{what}\n{', '.join(parts)}"
