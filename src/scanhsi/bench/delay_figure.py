"""A delay profile as a figure: how often each delay is exceeded, on a logarithmic axis, so that its tail is seen."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from scanhsi.bench.style import FORMAT_COLOURS, STAGE_COLOURS, canvas
from scanhsi.devices.errors import ConfigError
from scanhsi.timing.delays import DelayProfile, DelayStreams, Stream

_COLUMNS: Final = 3
_LONGEST_SOURCE: Final = 150


def draw_delays(profile: DelayProfile, lines: int) -> Figure:
    """One panel a stream that is not constant.

    Args:
        profile: To draw.
        lines: Delays drawn from each distribution.

    Raises:
        ConfigError: No delay of the profile varies.
    """
    varying = {stream: list(_drawn(profile, stream, lines)) for stream in profile.streams}
    varying = {stream: curves for stream, curves in varying.items() if curves}
    if not varying:
        raise ConfigError(f"profile {profile.name}: all of its delays are constant, there is nothing to draw.")
    columns = min(_COLUMNS, len(varying))
    rows = -(-len(varying) // columns)
    source = profile.source
    source = source if len(source) <= _LONGEST_SOURCE else f"{source[:_LONGEST_SOURCE]} ..."
    kinds = dict.fromkeys(kind for curves in varying.values() for kind, _ in curves if kind)
    legend = [Line2D([], [], color=_colour(kind), label=kind) for kind in kinds]
    legend.append(Line2D([], [], color="0.5", linestyle=":", label="mean"))
    title = f"Delays of {profile.name} ({profile.mark})"
    figure = canvas(7.3, 0.9 + 2.0 * rows, title=title, source=source, legend=legend)
    panels = figure.subplots(rows, columns, squeeze=False, sharey=True)
    for axes, (stream, curves) in zip(panels.flat, varying.items(), strict=False):
        _panel(axes, stream, curves, lines)
    for axes in panels.flat[len(varying) :]:
        axes.set_visible(False)
    for axes in panels[:, 0]:
        axes.set_ylabel("part of lines at least that long")
    return figure


def _drawn(profile: DelayProfile, stream: Stream, lines: int) -> Iterator[tuple[str | None, NDArray[np.float64]]]:
    streams = DelayStreams(profile, 0)
    for kind in profile.streams[stream].by_format or (None,):
        delays_ms = np.sort(streams.array_ns(stream, lines, pixel_format=kind)).astype(np.float64) * 1e-6
        if delays_ms[-1] > delays_ms[0]:
            yield kind, delays_ms


def _panel(axes: Axes, stream: str, curves: list[tuple[str | None, NDArray[np.float64]]], lines: int) -> None:
    above = 1 - np.arange(lines) / lines
    for kind, delays_ms in curves:
        axes.step(delays_ms, above, where="pre", color=_colour(kind))
        axes.axvline(float(delays_ms.mean()), color="0.5", linestyle=":", linewidth=1)
    axes.set_title(stream, fontweight="bold")
    axes.set_yscale("log")
    axes.set_ylim(0.7 / lines, 1.4)
    axes.set_xlabel("delay / ms")


def _colour(kind: str | None) -> str:
    return STAGE_COLOURS["move"] if kind is None else FORMAT_COLOURS.get(kind, "black")
