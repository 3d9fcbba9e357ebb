"""Rows of the mirror's drive."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Final

from scanhsi.calibration.backlash import Backlash
from scanhsi.calibration.jitter import Jitter
from scanhsi.calibration.repeatability import Repeatability
from scanhsi.characterise.spec_row import Make, Row, shown

_MEDIAN_OF_NORMAL: Final = 0.674  # of the magnitude of a normal number


def _jitter(result: Jitter, make: Make) -> list[Row]:
    slope = 0.1 / (_MEDIAN_OF_NORMAL * result.sigma_mm) if result.sigma_mm > 0 else math.nan
    text = f"10 % of a pixel where the intensity changes by {slope:.2f} of itself a mm" if slope == slope else ""
    return [
        make("jitter", "Jitter of the mirror, standard deviation", result.sigma_mm, "mm", result.sigma_error_mm),
        make("microstepping", "", slope, "1/mm", slope * result.sigma_error_mm / result.sigma_mm, text),
    ]


def _backlash(result: Backlash, make: Make) -> list[Row]:
    text = f"{shown(result.lag_steps, 'steps', result.lag_sigma_steps)}, {result.lag_mm:.3f} mm straight ahead"
    return [make("backlash", "Backlash of the mirror", result.lag_steps, "steps", result.lag_sigma_steps, text)]


def _repeatability(result: Repeatability, make: Make) -> list[Row]:
    ways = f"{result.upwards_steps:.2f} steps upwards, {result.downwards_steps:.2f} downwards"
    both = (
        f"{result.repeatability_steps:.2f} steps, {result.repeatability_steps * result.step_mm:.2f} mm straight ahead"
    )
    return [
        make(
            "repeatability",
            "Repeatability, bidirectional (ISO 230-2 style)",
            result.repeatability_steps,
            "steps",
            text=both,
        ),
        make(
            "repeatability one way",
            "Repeatability, unidirectional, 4 s",
            max(result.upwards_steps, result.downwards_steps),
            "steps",
            text=ways,
        ),
        make("approach", "Standard deviation of an approach", result.sigma_steps, "steps", result.sigma_error_steps),
        make("reversal", "Mean reversal value", result.reversal_steps, "steps", result.reversal_sigma_steps),
    ]


ROWS: Final[dict[str, Callable[[Any, Make], list[Row]]]] = {
    Jitter.kind: _jitter,
    Backlash.kind: _backlash,
    Repeatability.kind: _repeatability,
}
"""Kind of a result -> its rows."""
