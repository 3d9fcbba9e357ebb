"""Jitter, repeatability and backlash of the mirror (figure 8).

Three estimators of the jitter, since the paper's own is biased by some percent: its clipped spectrum (what of the residual's
spectrum lies above the mean noise is taken for a misalignment and cut), harmonic regression (the misalignment is periodic in the
mirror's turn: fit and remove it), and, for many lines, a target of slanted lines in which every scan line shows its displacement.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, cast

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from scanhsi.calibration.result import Provenance, Stored
from scanhsi.devices.errors import CalibrationError

Floats = NDArray[np.float64]

_LEAST_LINES = 12
_PADDING = 16  # of spectra, so that a frequency between two of theirs is found


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


def jitter(
    phase_rad: Floats, residual_mm: Floats, provenance: Provenance, *, harmonics: int = 2, fitted: int = 0
) -> Jitter:
    """Work out the jitter from the residuals of lines whose places are known.

    Args:
        phase_rad: Angle of the mirror (or of any shaft whose turn may be out of true) at each line, (line,).
        residual_mm: Place found less place expected, (line,).
        provenance: Where they come from.
        harmonics: Of the turn that are taken for misalignment; 0 for none.
        fitted: Parameters that were fitted to the same lines before (two of a geometry), which made the residuals smaller.

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


def displacements(lines: NDArray[np.floating], slope: float, sample_pitch_mm: float) -> Floats:
    """Displacement of each scan line along the scan, from a target of parallel slanted lines.

    A line that lies off by ``d`` sees the slanted lines moved along the slit by ``d / slope``. Displacements are told up to half
    the target's period: choose lines some ten times the jitter apart.

    Args:
        lines: (line, sample), one band of the slanted target, evenly scanned.
        slope: Rise of the target's lines along the scan for one unit along the slit: the tangent of 10 degrees, say. The even
            motion of the scan is found from the lines themselves and removed.
        sample_pitch_mm: Distance of the samples.

    Returns:
        (line,) mm, even motion removed.

    Raises:
        CalibrationError: No lines to be seen.
    """
    values = np.asarray(lines, np.float64)
    if values.ndim != 2 or min(values.shape) < 16 or not np.isfinite(values).all():
        raise CalibrationError(f"a slanted target needs 16 lines and samples at least, all known, not {values.shape}.")
    spectrum = np.fft.rfft(
        (values - values.mean(axis=1, keepdims=True)) * np.hanning(values.shape[1]), _PADDING * values.shape[1]
    )
    power = np.abs(spectrum).mean(axis=0)
    carrier = int(np.argmax(power[2 * _PADDING :])) + 2 * _PADDING
    if power[carrier] < 8 * np.median(power):
        raise CalibrationError(
            "no pattern of lines stands out along the slit.", hint="is the target in focus, and slanted?"
        )
    wave = spectrum[:, carrier] / np.abs(spectrum[:, carrier])
    phase = np.angle(wave * np.exp(-1j * _even_motion(wave) * np.arange(len(wave))))
    phase = np.angle(np.exp(1j * (phase - np.angle(np.mean(np.exp(1j * phase))))))
    return -phase / (2 * np.pi * carrier / (_PADDING * values.shape[1])) * sample_pitch_mm * slope


def _even_motion(wave: NDArray[np.complex128]) -> float:
    """Advance of the phase from one line to the next, rad: where the spectrum of the wave over the lines is highest."""
    size = _PADDING * len(wave)
    best = int(np.argmax(np.abs(np.fft.fft(wave, size))))
    line = np.arange(len(wave))

    def loss(advance: float) -> float:
        return -float(np.abs(np.sum(wave * np.exp(-1j * advance * line))))

    centre, step = 2 * np.pi * best / size, 2 * np.pi / size
    found = cast("Any", optimize.minimize_scalar(loss, bounds=(centre - step, centre + step), method="bounded"))
    return float(found.x)


def backlash_steps(forward: Floats, backward: Floats) -> float:
    """Steps by which a backward scan lags behind a forward one, from the same band along the scan.

    Args:
        forward: (line, ...) values at successive steps, upwards.
        backward: The same steps taken downwards, put in the order of ``forward``.

    Returns:
        The lag in lines, with fractions: the best match of the two; positive where the backward scan sees what the forward scan saw
        at higher steps, as play in the drive makes it.

    Raises:
        CalibrationError: Sizes that differ, too few lines, or nothing that varies along the scan.
    """
    first, second = (np.asarray(values, np.float64).reshape(len(values), -1) for values in (forward, backward))
    if first.shape != second.shape or len(first) < 16:
        raise CalibrationError(
            f"two scans of the same 16 lines at least are needed, not {first.shape} and {second.shape}."
        )
    if np.ptp(first, axis=0).max() == 0:
        raise CalibrationError("nothing varies along the scan: no shift can be seen.")
    reach = max(1, len(first) // 4)
    shifts = np.arange(-reach, reach + 1)
    mismatch = np.array([_mismatch(first, second, int(shift)) for shift in shifts])
    best = int(np.argmin(mismatch))
    whole = int(shifts[best])
    return -(whole + _fraction(first, second, whole))


def _overlap(first: Floats, second: Floats, shift: int) -> tuple[Floats, Floats]:
    """The parts of both that face each other when the second is moved by ``-shift`` lines."""
    lines = len(first)
    low, high = max(0, -shift), min(lines, lines - shift)
    return first[low:high], second[low + shift : high + shift]


def _mismatch(first: Floats, second: Floats, shift: int) -> float:
    here, there = _overlap(first, second, shift)
    return float(np.mean((here - there) ** 2))


def _fraction(first: Floats, second: Floats, whole: int) -> float:
    """The rest of the shift, by Gauss-Newton on the slope of the first scan."""
    here, there = _overlap(first, second, whole)
    line = np.arange(len(here), dtype=np.float64)
    slope = np.gradient(here, axis=0)
    shift = 0.0
    inner = slice(2, -2)
    for _ in range(20):
        moved = np.empty_like(there)
        for column in range(there.shape[1]):
            moved[:, column] = np.interp(line + shift, line, there[:, column])
        change = float(np.sum((here - moved)[inner] * slope[inner]) / np.sum(slope[inner] ** 2))
        shift = float(np.clip(shift + change, -1.5, 1.5))
        if abs(change) < 1e-4:
            break
    return shift
