"""A shaft out of true: with every turn of it the mirror leads and lags, by a cosine of the step (figure 8's misalignment).

Which shaft it is (mirror, pulley, motor) nobody has to say: the turn is looked for in the places of lines, where it has to stand
out of their noise.
"""

from __future__ import annotations

import math
from typing import Final, cast

import numpy as np
from numpy.typing import NDArray

from scanhsi.devices.errors import CalibrationError

Floats = NDArray[np.float64]

_FINER: Final = 8  # than the resolution of the record
_CHANCE: Final = 0.01  # that noise looks like a turn
_OWN: Final = 0.3  # of a cosine must be its own, beside the slow curve
_LEAST: Final = 12


def find_turn(steps: NDArray[np.floating], displacement: NDArray[np.floating], *, slow: int = 3) -> float | None:
    """Steps of one turn of a shaft that is out of true, from displacements of lines: the strongest cosine.

    Turns up to some two thirds of the record are tried (what is slower looks like perspective, or a wrong distance), down to four
    times the distance of its lines.

    Args:
        steps: Of the lines, (line,).
        displacement: Of the lines from where they should lie, in any unit, (line,).
        slow: Degree of a polynomial that is fitted beside the cosine: perspective, and what was fitted before.

    Returns:
        Steps; None where nothing stands out: noise alone would do as well with a chance of 1 %.

    Raises:
        CalibrationError: Too few lines, or displacements that are no numbers.
    """
    step, value = np.asarray(steps, np.float64), np.asarray(displacement, np.float64)
    if step.ndim != 1 or step.shape != value.shape or len(step) < max(_LEAST, slow + 6):
        raise CalibrationError(f"{value.shape} displacements are too few to find a turn in.")
    if not (np.isfinite(step).all() and np.isfinite(value).all()):
        raise CalibrationError("some displacements are no numbers.")
    span, spacing = float(np.ptp(step)), float(np.median(np.abs(np.diff(np.sort(step)))))
    if not spacing > 0:
        raise CalibrationError("the lines all lie at one step.")
    place = 2 * (step - step.min()) / span - 1
    basis = cast("Floats", np.linalg.qr(place[:, None] ** np.arange(slow + 1))[0])
    left = value - basis @ (basis.T @ value)
    coarse = np.arange(_FINER, max(_FINER + 1, int(_FINER * span / (4 * spacing)))) / (_FINER * span)
    taken = np.array([_explained(one, step, left, basis) for one in coarse.tolist()])
    best = float(coarse[int(np.argmax(taken))])
    fine = best + np.linspace(-1, 1, 41) / (_FINER * span)
    shares = np.array([_explained(one, step, left, basis) for one in fine.tolist()])
    freedom = len(step) - slow - 1
    chance = (1 - float(shares.max())) ** ((freedom - 2) / 2) * max(1.0, len(coarse) / _FINER * 2)
    return 1 / float(fine[int(np.argmax(shares))]) if chance < _CHANCE else None


def _explained(frequency: float, step: Floats, left: Floats, basis: Floats) -> float:
    """Share of the squares that a cosine of so many turns a step takes away; 0 where the slow curve looks much like it."""
    angle = 2 * np.pi * frequency * step
    waves = np.stack((np.cos(angle), np.sin(angle)), axis=1)
    whole = np.linalg.norm(waves)
    waves -= basis @ (basis.T @ waves)
    own, size, _ = np.linalg.svd(waves, full_matrices=False)
    if size[-1] < _OWN * whole / math.sqrt(2):
        return 0.0
    return float(np.sum((own.T @ left) ** 2) / max(float(np.sum(left**2)), 1e-300))
