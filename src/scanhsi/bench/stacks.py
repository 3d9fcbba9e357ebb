"""Fig. 5: the time of a line, stacked by stage, with the time that overlaps hatched."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from scanhsi.bench.observations import Observation, Session
from scanhsi.bench.scenarios import Scenario
from scanhsi.bench.style import FORMAT_TITLES, STAGE_COLOURS, canvas, source_of
from scanhsi.timing.spans import Share, shares

_ORDER: Final = ("exposure", "transfer", "copy", "store", "move", "waiting")
_HIDDEN: Final = ("exposure", "transfer", "copy", "move")
"""Stages whose overlapped time is drawn: of storing, most is waiting until a batch of lines is full."""
_BARS: Final = 7
_LONGEST_S: Final = 0.1
"""Longer exposures dwarf everything else."""
_SEEN: Final = 0.02
"""A stage below this part of every line is left out of the legend."""
_WIDTH: Final = 0.78
_HATCHED: Final[dict[str, Any]] = {"facecolor": "white", "hatch": "/////", "linewidth": 0.5}
_PERIOD: Final[dict[str, Any]] = {"color": "black", "linewidth": 1.2}


def draw_stacks(session: Session) -> Figure:
    """One panel for each pixel format (rows) and mode (columns); one bar an exposure."""
    scans = [seen for seen in session.observations if seen.scenario == Scenario.FULL and len(seen.periods_s)]
    chosen = _chosen(scans)
    bars = [_Bar(seen, shares(seen.stamps)) for seen in scans if seen.exposure_s in chosen]
    formats = list(dict.fromkeys(bar.seen.pixel_format for bar in bars))
    modes = list(dict.fromkeys(bar.seen.mode for bar in bars))
    figure = canvas(
        7.3,
        1.3 + 1.8 * len(formats),
        title="Time of a line by stage",
        source=source_of(session.facts),
        legend=_legend(bars),
    )
    panels = figure.subplots(len(formats), len(modes), sharex=True, sharey=True, squeeze=False)
    for row, pixel_format in enumerate(formats):
        for column, mode in enumerate(modes):
            axes: Axes = panels[row, column]
            _panel(
                axes, [bar for bar in bars if (bar.seen.pixel_format, bar.seen.mode) == (pixel_format, mode)], chosen
            )
            axes.set_ylim(0, 1.04e3 * max(bar.height_s for bar in bars))
            if not row:
                axes.set_title(mode, fontweight="bold")
            if row == len(formats) - 1:
                axes.set_xlabel("exposure / ms")
            if not column:
                axes.set_ylabel(f"{FORMAT_TITLES[pixel_format]}\nms a line")
    return figure


@dataclass(frozen=True, slots=True)
class _Bar:
    seen: Observation
    stages: dict[str, Share]

    @property
    def period_s(self) -> float:
        return float(self.seen.periods_s.mean())

    @property
    def height_s(self) -> float:
        return self.period_s + sum(self.stages[stage].hidden_s for stage in _HIDDEN if stage in self.stages)


def _chosen(scans: Sequence[Observation]) -> list[float]:
    exposures = sorted({seen.exposure_s for seen in scans})
    return ([exposure for exposure in exposures if exposure <= _LONGEST_S] or exposures)[:_BARS]


def _panel(axes: Axes, bars: Sequence[_Bar], exposures: list[float]) -> None:
    """Solid: what adds up to the line period. Hatched above it: work done meanwhile. White: efficiency in per cent."""
    axes.grid(visible=False, axis="x")
    axes.set_xticks(range(len(exposures)), [f"{exposure * 1e3:g}" for exposure in exposures])
    axes.tick_params(axis="x", length=0)
    places = np.array([exposures.index(bar.seen.exposure_s) for bar in bars], np.float64)
    none, height = Share(0.0, 0.0), np.zeros(len(bars))
    for stage in _ORDER:
        length = np.array([bar.stages.get(stage, none).alone_s for bar in bars]) * 1e3
        axes.bar(places, length, bottom=height, width=_WIDTH, color=STAGE_COLOURS[stage], linewidth=0)
        height += length
    axes.hlines(height, places - 0.44, places + 0.44, **_PERIOD)
    for stage in _HIDDEN:
        length = np.array([bar.stages.get(stage, none).hidden_s for bar in bars]) * 1e3
        axes.bar(places, length, bottom=height, width=_WIDTH, edgecolor=STAGE_COLOURS[stage], **_HATCHED)
        height += length
    for place, bar in zip(places, bars, strict=True):
        efficiency = f"{100 * bar.seen.exposure_s / bar.period_s:.0f}"
        axes.text(place, 1.2, efficiency, color="white", fontsize=5.5, ha="center", va="bottom")


def _legend(bars: Sequence[_Bar]) -> list[Artist]:
    drawn = [
        Patch(facecolor=STAGE_COLOURS[stage], label=stage)
        for stage in _ORDER
        if any(stage in bar.stages and _worth_a_name(bar.stages[stage], bar.period_s) for bar in bars)
    ]
    return [
        *drawn,
        Patch(label="overlapped", edgecolor="0.4", **_HATCHED),
        Line2D([], [], label="line period", **_PERIOD),
        Line2D(
            [], [], linestyle="", marker="$75$", markersize=7, markeredgewidth=0, color="0.3", label="efficiency, %"
        ),
    ]


def _worth_a_name(share: Share, period_s: float) -> bool:
    return share.alone_s + share.hidden_s > _SEEN * period_s
