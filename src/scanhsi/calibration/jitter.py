"""Jitter of the mirror (figure 8).

Three estimators of the jitter, since the paper's own is biased by some percent: its clipped spectrum (what of the residual's
spectrum lies above the mean noise is taken for a misalignment and cut), harmonic regression (the misalignment is periodic in the
mirror's turn: fit and remove it), and, for many lines, a target of slanted lines in which every scan line shows its displacement.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray

from scanhsi.calibration.result import Provenance, Stored
from scanhsi.devices.errors import CalibrationError

Floats = NDArray[np.float64]

_LEAST_LINES = 12


@dataclass(frozen=True, slots=True, eq=False)
class Jitter:
    """How far lines lie from where the model puts them.

    Attributes:
        sigma_mm, sigma_error_mm: Standard deviation of the jitter by harmonic regression, with its standard error: the one to use.
        paper_mm: The same by the paper's clipped spectrum.
        raw_mm: Standard deviation of the residuals as they are, misalignment included.
        misalignment_mm: Amplitude of the periodic part that was removed.
        harmonics: Number of harmonics removed.
        residual_mm: Residuals with the periodic part removed, (line,).
        provenance: Where it comes from.
        turn_steps: Steps of the turn whose harmonics were removed; nan where none was.
    """

    kind: ClassVar[str] = "jitter"

    sigma_mm: Annotated[float, Stored("mm", "standard deviation of the jitter")]
    sigma_error_mm: Annotated[float, Stored("mm", "its standard error")]
    paper_mm: Annotated[float, Stored("mm", "the same by the clipped spectrum of the paper")]
    raw_mm: Annotated[float, Stored("mm", "standard deviation of the residuals as they are")]
    misalignment_mm: Annotated[float, Stored("mm", "amplitude of the periodic part")]
    harmonics: int
    residual_mm: Annotated[Floats, Stored("mm", "residuals without the periodic part", ("line",))]
    provenance: Provenance
    turn_steps: Annotated[float, Stored("steps", "turn of the shaft out of true")] = math.nan


def jitter(
    phase_rad: Floats,
    residual_mm: Floats,
    provenance: Provenance,
    *,
    harmonics: int = 2,
    fitted: int = 0,
    turn_steps: float = math.nan,
) -> Jitter:
    """Work out the jitter from the residuals of lines whose places are known.

    Args:
        phase_rad: Angle of the mirror (or of any shaft whose turn may be out of true) at each line, (line,).
        residual_mm: Place found less place expected, (line,).
        provenance: Where they come from.
        harmonics: Of the turn that are taken for misalignment; 0 for none.
        fitted: Parameters that were fitted to the same lines before (two of a geometry), which made the residuals smaller.
        turn_steps: What the phase counts, for the result.

    Raises:
        CalibrationError: Fewer than a dozen lines, or residuals that are no numbers.
    """
    phase, residual = np.asarray(phase_rad, np.float64), np.asarray(residual_mm, np.float64)
    if (
        phase.ndim != 1
        or phase.shape != residual.shape
        or len(residual) < max(_LEAST_LINES, 2 * harmonics + fitted + 3)
    ):
        raise CalibrationError(
            f"jitter needs {_LEAST_LINES} lines with their angles at least, not {residual.shape}.",
            hint="a finer grid, or the slanted lines, which give one value a scan line",
        )
    if not (np.isfinite(phase).all() and np.isfinite(residual).all()):
        raise CalibrationError("some residuals are no numbers.")
    columns = [np.ones_like(phase)]
    for order in range(1, harmonics + 1):
        columns += [np.cos(order * phase), np.sin(order * phase)]
    design = np.stack(columns, axis=1)
    coefficients, _, rank, _ = np.linalg.lstsq(design, residual, rcond=1e-9)
    periodic = design @ coefficients
    left = residual - periodic
    freedom = len(residual) - int(rank) - fitted
    sigma = math.sqrt(float(np.sum(left**2)) / freedom)
    return Jitter(
        sigma_mm=sigma,
        sigma_error_mm=sigma / math.sqrt(2 * freedom),
        paper_mm=clipped_sigma(residual),
        raw_mm=float(np.std(residual, ddof=1)),
        misalignment_mm=float(np.ptp(periodic)) / 2,
        harmonics=harmonics,
        residual_mm=left,
        provenance=provenance,
        turn_steps=turn_steps,
    )


def clipped_sigma(residual: Floats) -> float:
    """The paper's estimate: power above the mean of the spectrum is cut down to it, the rest is noise.

    The mean includes what is to be cut, so the cut takes some of the noise too: 3 % too low with many lines, and no better than
    15 % with twenty.
    """
    spectrum = np.fft.rfft(residual - residual.mean())
    power = np.abs(spectrum) ** 2
    weight = np.full(len(power), 2.0)  # of both signs of the frequency
    weight[0] = 0.0
    if len(residual) % 2 == 0:
        weight[-1] = 1.0
    mean = float(np.sum(weight * power) / np.sum(weight))
    kept = np.minimum(power, mean)
    return math.sqrt(float(np.sum(weight * kept))) / len(residual)
