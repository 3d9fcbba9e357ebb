"""Figures of the mirror's drive: backlash and repeatability."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure

from scanhsi.calibration.backlash import Backlash
from scanhsi.calibration.figures.style import BLUE, GREY, ORANGE, sheet
from scanhsi.calibration.repeatability import Repeatability

_SHOWN: Final = 60  # lines of the scan, from the middle
_WAYS: Final = ((BLUE, "upwards", -0.12), (ORANGE, "downwards", 0.12))


def draw_backlash(result: Backlash) -> Figure:
    """What both scans see in the middle of the slit, and the lag of each part of the scans."""
    figure = sheet("Backlash of the mirror", result.provenance)
    left, right = figure.subplots(1, 2, width_ratios=(1.4, 1))
    middle = slice(max(0, (len(result.step) - _SHOWN) // 2), (len(result.step) + _SHOWN) // 2)
    left.plot(result.step[middle], result.forward[middle], ".-", color=BLUE, linewidth=0.8, label="upwards")
    left.plot(result.step[middle], result.backward[middle], ".-", color=ORANGE, linewidth=0.8, label="downwards")
    left.set_xlabel("mirror step")
    left.set_ylabel("middle of the slit / counts")
    low, high = left.get_ylim()
    left.set_ylim(low, high + 0.18 * (high - low))
    left.legend(ncols=2, loc="upper center")
    for run, lags in enumerate(result.part_lag_steps):
        right.plot(
            result.part_step, lags, "o", color=BLUE, markersize=3, label="parts of the scans" if run == 0 else None
        )
    right.axhline(result.lag_steps, color=ORANGE, label="mean")
    if np.isfinite(result.lag_sigma_steps):
        right.axhspan(
            result.lag_steps - result.lag_sigma_steps, result.lag_steps + result.lag_sigma_steps, color="0.88", zorder=0
        )
    right.set_xlabel("mirror step")
    right.set_ylabel("lag / steps")
    right.set_title(f"{result.lag_steps:.2f} $\\pm$ {result.lag_sigma_steps:.2f} steps, {result.lag_mm:.3f} mm")
    low, high = right.get_ylim()
    right.set_ylim(min(low, 0), high + 0.25 * (high - min(low, 0)))
    right.legend(ncols=2, loc="upper center")
    return figure


def draw_repeatability(result: Repeatability) -> Figure:
    """Every approach, mean and two standard deviations of either direction, and how approaches scatter."""
    figure = sheet("Repeatability of the mirror", result.provenance)
    left, right = figure.subplots(1, 2, width_ratios=(1.7, 1))
    spacing = float(np.median(np.diff(result.position_step)))
    for way, (colour, name, aside) in enumerate(_WAYS):
        place = result.position_step + aside * spacing
        for run in result.deviation_steps[way]:
            left.plot(place, run, ".", color=colour, markersize=2.5, alpha=0.6)
        two = 2 * result.deviation_sigma_steps[way]
        left.errorbar(place, result.mean_steps[way], yerr=two, color=colour, linewidth=1, capsize=2, label=name)
    left.axhline(0, color=GREY, linewidth=0.7)
    left.set_xlabel("mirror step")
    left.set_ylabel("deviation / steps")
    low, high = left.get_ylim()
    left.set_ylim(low, high + 0.2 * (high - low))
    left.legend(title="mean and 2 s", ncols=2, loc="upper center")
    rest = result.deviation_steps - result.mean_steps[:, None]
    bins = np.linspace(float(rest.min()), float(rest.max()), 13).tolist()
    for way, (colour, name, _) in enumerate(_WAYS):
        right.hist(rest[way].ravel(), bins, color=colour, histtype="step", label=name)
    right.set_xlabel("deviation from the direction's mean / steps")
    right.set_ylabel("approaches")
    right.set_title(
        f"s = {result.sigma_steps:.2f}, reversal {result.reversal_steps:.2f}, R = {result.repeatability_steps:.1f} steps"
    )
    return figure


FIGURES: Final[dict[str, Callable[[Any], Figure]]] = {
    Backlash.kind: draw_backlash,
    Repeatability.kind: draw_repeatability,
}
"""Kind of a result -> its figure."""
