"""Backlash of the mirror's drive: a scan downwards lags behind one upwards by the play of belt and gears.

Both see the same target at the same steps; the lag is the shift along the scan at which they match best, found to a fraction of a
line.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from scanhsi.calibration.result import Provenance, Stored
from scanhsi.devices.errors import CalibrationError

Floats = NDArray[np.float64]

_LEAST_LINES: Final = 16
_PARTS: Final = 8
_PART_LINES: Final = 24
_NEAR: Final = 3
_LEADS: Final = 2  # lines that noise, or none, may seem to lead
_ALIKE: Final = 0.15  # of the way from the best match to the usual one: as good a match, in a target that repeats


@dataclass(frozen=True, slots=True, eq=False)
class Backlash:
    """By how much the mirror lags when it comes from above.

    Attributes:
        lag_steps, lag_sigma_steps: Mean of the parts of the scan, with its standard error; positive where the backward scan sees at
            a step what the forward scan sees at a higher one.
        lag_mm: The same in the object plane, straight ahead.
        part_step: Middle step of each part, (part,).
        part_lag_steps: Lag in each part, (run, part).
        step: Of the lines compared, (line,).
        forward, backward: What the first two scans see in the middle of the slit, (line,).
        provenance: Where it comes from.
    """

    kind: ClassVar[str] = "backlash"

    lag_steps: Annotated[float, Stored("steps", "lag of the backward scan")]
    lag_sigma_steps: Annotated[float, Stored("steps", "its standard error")]
    lag_mm: Annotated[float, Stored("mm", "lag in the object plane")]
    part_step: Annotated[Floats, Stored("steps", "middle of a part of the scan", ("part",))]
    part_lag_steps: Annotated[Floats, Stored("steps", "lag in a part of the scan", ("run", "part"))]
    step: Annotated[Floats, Stored("steps", "mirror step", ("line",))]
    forward: Annotated[Floats, Stored("counts", "forward scan, middle of the slit", ("line",))]
    backward: Annotated[Floats, Stored("counts", "backward scan, middle of the slit", ("line",))]
    provenance: Provenance


def backlash(
    forward: Sequence[Floats],
    backward: Sequence[Floats],
    steps: Floats,
    step_mm: float,
    provenance: Provenance,
    *,
    parts: int = _PARTS,
) -> Backlash:
    """Work out the backlash from scans upwards and as many downwards.

    The scans are cut into parts that are matched one by one: their scatter, in which the mirror's jitter shows, gives the error.

    Args:
        forward: (line, sample) each, of a target with structure along the scan, at rising steps, evenly spaced.
        backward: The same steps taken downwards, in the order of ``forward``.
        steps: Of the lines, rising, (line,).
        step_mm: What one step is in the object plane, straight ahead.
        provenance: Where the scans come from.
        parts: How many; fewer where they would be shorter than 24 lines.

    Raises:
        CalibrationError: See `backlash_steps`; or steps that are not evenly spaced.
    """
    step = np.asarray(steps, np.float64)
    stride = np.diff(step)
    pairs = list(zip(forward, backward, strict=False))
    if not pairs or len(forward) != len(backward):
        raise CalibrationError(
            f"as many scans upwards as downwards are needed, not {len(forward)} and {len(backward)}."
        )
    fits = all(scan.shape[:1] == step.shape for pair in pairs for scan in pair)
    if not fits or len(step) < _LEAST_LINES or not np.allclose(stride, stride[0]):
        raise CalibrationError(f"backlash needs {_LEAST_LINES} lines at least, their steps evenly spaced.")
    whole = float(np.mean([backlash_steps(up, down) for up, down in pairs]))
    cuts = np.array_split(np.arange(len(step)), max(1, min(parts, len(step) // _PART_LINES)))
    found = [[backlash_steps(up[part], down[part], near=whole) for part in cuts] for up, down in pairs]
    lags = np.array(found) * stride[0]
    several = lags.size > 2
    lag = float(lags.mean()) if several else whole * float(stride[0])
    middle = pairs[0][0].shape[1] // 2
    return Backlash(
        lag_steps=lag,
        lag_sigma_steps=float(lags.std(ddof=1)) / math.sqrt(lags.size) if several else math.nan,
        lag_mm=lag * step_mm,
        part_step=np.array([step[part].mean() for part in cuts]),
        part_lag_steps=lags,
        step=step,
        forward=np.asarray(pairs[0][0][:, middle], np.float64),
        backward=np.asarray(pairs[0][1][:, middle], np.float64),
        provenance=provenance,
    )


def backlash_steps(forward: Floats, backward: Floats, *, near: float | None = None) -> float:
    """Steps by which a backward scan lags behind a forward one, from the same band along the scan.

    Args:
        forward: (line, ...) values at successive steps, upwards.
        backward: The same steps taken downwards, put in the order of ``forward``.
        near: Lag in lines that is roughly right; none farther than three lines from it is tried. None: any up to a quarter of the
            scan, and of those at which a target that repeats along it matches alike, the smallest that lags.

    Returns:
        The lag in lines, with fractions: the best match of the two; positive where the backward scan sees what the forward scan saw
        at higher steps, as play in the drive makes it.

    Raises:
        CalibrationError: Sizes that differ, too few lines, values that are no numbers, or nothing that varies along the scan.
    """
    first, second = (np.asarray(values, np.float64).reshape(len(values), -1) for values in (forward, backward))
    if first.shape != second.shape or len(first) < _LEAST_LINES:
        raise CalibrationError(
            f"two scans of the same {_LEAST_LINES} lines at least are needed, not {first.shape} and {second.shape}."
        )
    if not (np.isfinite(first).all() and np.isfinite(second).all()):
        raise CalibrationError("some values are no numbers: saturated, or missing lines.")
    if np.ptp(first, axis=0).max() == 0:
        raise CalibrationError("nothing varies along the scan: no shift can be seen.")
    reach = max(1, len(first) // 4)
    shifts = np.arange(-reach, reach + 1)
    if near is not None:
        shifts = round(-near) + np.arange(-_NEAR, _NEAR + 1)
    mismatch = np.array([_mismatch(first, second, int(shift)) for shift in shifts])
    inner = np.r_[False, (mismatch[1:-1] <= mismatch[:-2]) & (mismatch[1:-1] <= mismatch[2:]), False]
    limit = mismatch.min() + _ALIKE * (np.median(mismatch) - mismatch.min())
    alike = np.flatnonzero((inner & (mismatch <= limit)) | (mismatch == mismatch.min()))
    lags = -shifts[alike]
    far = np.abs(lags - (near or 0.0))
    if near is None:  # play lags, it does not lead: of a target that repeats, that is what tells which match is meant
        far = np.where(lags < -_LEADS, far + len(first), far)
    whole = int(shifts[alike[np.argmin(far)]])
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
