"""Fig. 6, lines per second, and Fig. 13, efficiency, against exposure, each with the laws fitted to it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import PercentFormatter
from numpy.typing import NDArray

from scanhsi.bench.curves import Curve
from scanhsi.bench.fits import Law
from scanhsi.bench.scenarios import Scenario
from scanhsi.bench.style import (
    CONTINUOUS_COLOUR,
    FORMAT_COLOURS,
    FORMAT_MARKERS,
    FORMAT_TITLES,
    IDEAL,
    SCENARIO_COLOURS,
    SCENARIO_MARKERS,
    canvas,
    exposure_axis,
)
from scanhsi.engine import Mode

_HEADROOM: Final = 1.18
_WIDTHS: Final = {"full": 1.2, "static": 1.7, "acquire": 2.4}
_NOTHING_S: Final = 2e-5
"""What is added to the exposure is not written below this."""
_CONTINUOUS: Final[dict[str, Any]] = {
    "color": CONTINUOUS_COLOUR,
    "marker": "D",
    "markersize": 2.6,
    "markeredgewidth": 0.9,
}


def draw_rates(curves: Sequence[Curve], source: str) -> Figure:
    """Fig. 6: one panel for each pixel format (columns); the paper's sequential scans above, overlapped ones below."""
    rows = [
        [curve for curve in curves if (curve.mode == Mode.SEQUENTIAL) is sequential] for sequential in (True, False)
    ]
    rows = [row for row in rows if row]
    formats = list(dict.fromkeys(curve.pixel_format for curve in curves))
    figure = canvas(
        7.3,
        0.9 + 2.3 * len(rows),
        title="Lines per second against exposure T, with the line periods fitted",
        source=source,
        legend=_rate_legend(curves),
    )
    panels = figure.subplots(len(rows), len(formats), sharex=True, sharey=True, squeeze=False)
    top = _HEADROOM * max(float((1 / curve.period_s).max()) for curve in curves)
    for row, members in enumerate(rows):
        for column, pixel_format in enumerate(formats):
            axes: Axes = panels[row, column]
            here = [curve for curve in members if curve.pixel_format == pixel_format]
            _rate_panel(axes, here)
            axes.set_ylim(0, top)
            if not row:
                axes.set_title(FORMAT_TITLES.get(pixel_format, pixel_format), fontweight="bold")
            if row == len(rows) - 1:
                axes.set_xlabel("exposure / ms")
            if not column:
                axes.set_ylabel(f"{_modes(members)}\nlines / s")
    return figure


def draw_efficiencies(curves: Sequence[Curve], source: str) -> Figure:
    """Fig. 13: one panel for each mode, one curve for each pixel format; full scenario."""
    full = [curve for curve in curves if curve.scenario == Scenario.FULL]
    modes = list(dict.fromkeys(curve.mode for curve in full))
    legend = [
        Line2D([], [], label=FORMAT_TITLES[name], **_format_look(name))
        for name in dict.fromkeys(curve.pixel_format for curve in full)
    ]
    figure = canvas(
        7.3, 3.2, title="Efficiency against exposure T, with the line periods fitted", source=source, legend=legend
    )
    panels = figure.subplots(1, len(modes), sharex=True, sharey=True, squeeze=False)
    for column, mode in enumerate(modes):
        axes: Axes = panels[0, column]
        _efficiency_panel(axes, [curve for curve in full if curve.mode == mode])
        axes.set_title(mode, fontweight="bold")
        axes.set_xlabel("exposure / ms")
    panels[0, 0].set_ylabel("efficiency")
    return figure


def _rate_panel(axes: Axes, curves: Sequence[Curve]) -> None:
    if not curves:
        axes.set_axis_off()
        return
    exposure_s = _grid(curves)
    axes.plot(exposure_s * 1e3, 1 / exposure_s, **IDEAL)
    exposure_axis(axes, (curves[0].exposure_s * 1e3).tolist())
    for place, curve in enumerate(curves):
        look = _look(curve)
        width = 0.9 if curve.mode == Mode.CONTINUOUS else _WIDTHS[curve.scenario]
        order = 3 - width / 10  # curves that lie on each other show as rims
        rates = 1 / curve.law.period_s(exposure_s)
        axes.plot(exposure_s * 1e3, rates, color=look["color"], linewidth=width, zorder=order)
        axes.plot(curve.exposure_s * 1e3, 1 / curve.period_s, linestyle="", zorder=order + 0.5, **look)
        _write(axes, 0.98 - 0.09 * place, curve.law, look["color"])


def _efficiency_panel(axes: Axes, curves: Sequence[Curve]) -> None:
    exposure_s = _grid(curves)
    exposure_axis(axes, (curves[0].exposure_s * 1e3).tolist())
    axes.axhline(1, **IDEAL)
    axes.set_ylim(0, 1.06)
    axes.yaxis.set_major_formatter(PercentFormatter(1, decimals=0))
    for place, curve in enumerate(reversed(curves)):
        colour = FORMAT_COLOURS[curve.pixel_format]
        axes.plot(exposure_s * 1e3, exposure_s / curve.law.period_s(exposure_s), color=colour)
        axes.plot(
            curve.exposure_s * 1e3, curve.exposure_s / curve.period_s, linestyle="", **_format_look(curve.pixel_format)
        )
        _write(axes, 0.09 + 0.075 * place, curve.law, colour)


def _write(axes: Axes, height: float, law: Law, colour: str) -> None:
    axes.text(
        0.99,
        height,
        describe(law),
        color=colour,
        fontsize=6.5,
        ha="right",
        va="top",
        transform=axes.transAxes,
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.8},
        zorder=4,
    )


def describe(law: Law) -> str:
    """A law for a figure, each parameter with the half width of its interval."""
    if law.floor is None:
        return f"T + {law.added} ms"
    nothing = abs(law.added.value) < _NOTHING_S
    return f"max({'T' if nothing else f'T + {law.added}'}, {law.floor}) ms"


def _format_look(pixel_format: str) -> dict[str, Any]:
    return {"color": FORMAT_COLOURS[pixel_format], "marker": FORMAT_MARKERS[pixel_format]}


def _grid(curves: Sequence[Curve]) -> NDArray[np.float64]:
    low = min(float(curve.exposure_s[0]) for curve in curves)
    high = max(float(curve.exposure_s[-1]) for curve in curves)
    return np.logspace(math.log10(low), math.log10(high), 400)


def _look(curve: Curve) -> dict[str, Any]:
    """Colour and marker of a curve; open markers of different shapes stay visible where curves coincide."""
    if curve.mode == Mode.CONTINUOUS:
        return _CONTINUOUS
    return _scenario_look(curve.scenario)


def _scenario_look(scenario: str) -> dict[str, Any]:
    colour, full = SCENARIO_COLOURS[scenario], scenario == Scenario.FULL
    return {
        "color": colour,
        "marker": SCENARIO_MARKERS[scenario],
        "markersize": 3.6 if full else 5.4,
        "markerfacecolor": colour if full else "none",
        "markeredgewidth": 0.9,
    }


def _modes(curves: Sequence[Curve]) -> str:
    return ", ".join(dict.fromkeys(curve.mode for curve in curves))


def _rate_legend(curves: Sequence[Curve]) -> list[Artist]:
    scenarios = dict.fromkeys(curve.scenario for curve in curves if curve.mode != Mode.CONTINUOUS)
    handles: list[Artist] = [Line2D([], [], label=Scenario(name).words, **_scenario_look(name)) for name in scenarios]
    if any(curve.mode == Mode.CONTINUOUS for curve in curves):
        handles.append(Line2D([], [], label="continuous", **_CONTINUOUS))
    return [*handles, Line2D([], [], label="ideal, 1/T", **IDEAL)]
