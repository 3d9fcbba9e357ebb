"""Repeatability of the mirror: how well it comes back to where it was, from either side (in the style of ISO 230-2).

Positions are approached several times upwards and downwards. From the deviations come, at each position, the mean and the standard
deviation of either direction and the reversal value, their difference; and over all of them the unidirectional and bidirectional
repeatability, four standard deviations wide as machine tools have it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar, Final, cast

import numpy as np
from numpy.typing import NDArray

from scanhsi.calibration.result import Provenance, Stored
from scanhsi.devices.errors import CalibrationError

Floats = NDArray[np.float64]

_WAYS: Final = ("direction", "position")
_COVERAGE: Final = 2.0
_LEAST_RUNS: Final = 3
_LEAST_POSITIONS: Final = 5


@dataclass(frozen=True, slots=True, eq=False)
class Repeatability:
    """How well positions are met again. Direction 0 is upwards, 1 downwards; all deviations in mirror steps.

    Attributes:
        position_step: Steps approached, (position,).
        deviation_steps: Of each approach from the mean of all to this position, (direction, run, position).
        mean_steps: Of each direction, (direction, position).
        deviation_sigma_steps: Standard deviation of the approaches, (direction, position).
        reversal_steps, reversal_sigma_steps: Mean reversal value, downwards less upwards, with its standard error: the backlash.
        sigma_steps, sigma_error_steps: Standard deviation of an approach, of all positions and directions, with its standard error.
        upwards_steps, downwards_steps: Unidirectional repeatability: the largest 4 s of a position.
        repeatability_steps: Bidirectional: the largest of 2 s upwards + 2 s downwards + reversal, and of the unidirectional ones.
        step_mm: What one step is in the object plane, straight ahead.
        provenance: Where it comes from.
    """

    kind: ClassVar[str] = "repeatability"

    position_step: Annotated[Floats, Stored("steps", "step approached", ("position",))]
    deviation_steps: Annotated[Floats, Stored("steps", "deviation of an approach", ("direction", "run", "position"))]
    mean_steps: Annotated[Floats, Stored("steps", "mean of a direction", _WAYS)]
    deviation_sigma_steps: Annotated[Floats, Stored("steps", "standard deviation of the approaches", _WAYS)]
    reversal_steps: Annotated[float, Stored("steps", "mean reversal value")]
    reversal_sigma_steps: Annotated[float, Stored("steps", "its standard error")]
    sigma_steps: Annotated[float, Stored("steps", "standard deviation of an approach")]
    sigma_error_steps: Annotated[float, Stored("steps", "its standard error")]
    upwards_steps: Annotated[float, Stored("steps", "unidirectional repeatability upwards")]
    downwards_steps: Annotated[float, Stored("steps", "unidirectional repeatability downwards")]
    repeatability_steps: Annotated[float, Stored("steps", "bidirectional repeatability")]
    step_mm: Annotated[float, Stored("mm", "one step in the object plane")]
    provenance: Provenance

    @property
    def runs(self) -> int:
        """Approaches to a position from either side."""
        return self.deviation_steps.shape[1]


def repeatability(
    upwards: Floats, downwards: Floats, position_step: Floats, step_mm: float, provenance: Provenance
) -> Repeatability:
    """Work out the repeatability from where each approach ended.

    Args:
        upwards: Places found, in steps from any origin of the position, (run, position).
        downwards: The same of the approaches from above, as many.
        position_step: Steps approached, (position,).
        step_mm: What one step is in the object plane, straight ahead.
        provenance: Where they come from.

    Raises:
        CalibrationError: Fewer than three runs or five positions, sizes that differ, or places that are no numbers.
    """
    places = [np.asarray(one, np.float64) for one in (upwards, downwards)]
    position = np.asarray(position_step, np.float64)
    if places[0].shape != places[1].shape or places[0].ndim != 2 or places[0].shape[1:] != position.shape:
        raise CalibrationError(f"runs of {places[0].shape} and {places[1].shape} at {position.shape} do not fit.")
    runs, positions = places[0].shape
    if runs < _LEAST_RUNS or positions < _LEAST_POSITIONS:
        raise CalibrationError(
            f"repeatability needs {_LEAST_RUNS} runs in either direction to {_LEAST_POSITIONS} positions at least, "
            f"not {runs} to {positions}.",
            hint="five runs to eleven positions are usual",
        )
    both: Floats = np.stack(places)
    if not np.isfinite(both).all():
        raise CalibrationError("some places are no numbers.")
    both = both - both.mean(axis=(0, 1))
    mean, sigma = (cast("Floats", one) for one in (both.mean(axis=1), both.std(axis=1, ddof=1)))
    reversal: Floats = mean[1] - mean[0]
    freedom = 2 * positions * (runs - 1)
    pooled = math.sqrt(float(np.mean(sigma**2)))
    spread = _COVERAGE * (sigma[0] + sigma[1]) + np.abs(reversal)
    one_way = 2 * _COVERAGE * sigma.max(axis=1)
    return Repeatability(
        position_step=position,
        deviation_steps=both,
        mean_steps=mean,
        deviation_sigma_steps=sigma,
        reversal_steps=float(reversal.mean()),
        reversal_sigma_steps=float(reversal.std(ddof=1)) / math.sqrt(positions),
        sigma_steps=pooled,
        sigma_error_steps=pooled / math.sqrt(2 * freedom),
        upwards_steps=float(one_way[0]),
        downwards_steps=float(one_way[1]),
        repeatability_steps=max(float(spread.max()), float(one_way.max())),
        step_mm=step_mm,
        provenance=provenance,
    )
