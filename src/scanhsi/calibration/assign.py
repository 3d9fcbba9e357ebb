"""Which peak is which line: found from their distances alone, with peaks that are no line and lines that show no peak.

Two peaks and two lines make a straight dispersion; all such pairs within what the instrument can have are tried (or, where there
are too many, some at random: RANSAC), and each is judged by how many other peaks it puts on lines. The best ones are bent to a
polynomial, step by step with a narrower tolerance. Brightness is not used: a lamp's spectrum changes with its age and warmth,
and sensors see half of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import optimize

from scanhsi.calibration.dispersion import Dispersion, fit_dispersion
from scanhsi.calibration.lines import LineList
from scanhsi.devices.errors import CalibrationError

Floats = NDArray[np.float64]

_TRIALS: Final = 40_000
_KEPT: Final = 60
_BATCH: Final = 2_000
_RIVAL: Final = 0.97  # of the best one's score, at which the answer is not clear


@dataclass(frozen=True, slots=True)
class DispersionRange:
    """What is known of the instrument beforehand.

    Attributes:
        nm_per_band: Least and most change of the wavelength a band; negative where it falls.
        first_nm: Least and most wavelength at band 0.
        bend_nm: How far the dispersion may bend from a straight line over the sensor.
    """

    nm_per_band: tuple[float, float] = (0.45, 0.65)
    first_nm: tuple[float, float] = (340.0, 430.0)
    bend_nm: float = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class Assignment:
    """Peaks and their lines.

    Attributes:
        peak: Indices of the peaks that are lines, rising, (pair,).
        line: Index of the line of each, (pair,).
        dispersion: Through the pairs.
        score: How well it explains the peaks, from 0 to their number.
        rival: Score of the best one that is essentially different.
    """

    peak: NDArray[np.intp]
    line: NDArray[np.intp]
    dispersion: Dispersion
    score: float
    rival: float


def assign_lines(
    centre_px: ArrayLike,
    lines: LineList,
    *,
    prior: DispersionRange | None = None,
    degree: int = 2,
    tolerance_nm: float = 0.6,
    seed: int = 0,
) -> Assignment:
    """Find which peak is which line.

    Args:
        centre_px: Places of the peaks in bands, (peak,).
        lines: Candidates, merged to the resolution of the instrument.
        prior: What the dispersion may be; None: that of the paper's instrument, generously.
        degree: Of the polynomial.
        tolerance_nm: How far a peak may lie from its line in the end.
        seed: Of the random choice.

    Raises:
        CalibrationError: Too few peaks, or no dispersion, or more than one, explains enough of them.
    """
    peaks = np.asarray(centre_px, np.float64)
    prior = prior or DispersionRange()
    least = degree + 3
    if peaks.ndim != 1 or not np.isfinite(peaks).all():
        raise CalibrationError(f"the places of the peaks are no row of numbers, {peaks.shape}.")
    if len(peaks) < least or len(lines) < least:
        raise CalibrationError(
            f"{len(peaks)} peaks and {len(lines)} lines are too few to find which is which; {least} of each at least.",
            hint="a longer exposure, or a lamp with more lines",
        )
    order = np.argsort(peaks, kind="stable")
    sorted_peaks, known = peaks[order], lines.wavelength_nm
    found: list[Assignment] = []
    for first_nm, slope in _straight(sorted_peaks, known, prior, seed):
        bent = _bend(sorted_peaks, known, first_nm, slope, prior, degree, tolerance_nm)
        if bent is not None:
            found.append(bent)
    if not found:
        raise _nothing_fits(least)
    best = max(found, key=lambda one: one.score)
    rival = max((one.score for one in found if _differs(one, best, sorted_peaks, tolerance_nm)), default=0.0)
    if len(best.peak) < max(least, len(peaks) // 2):
        raise _nothing_fits(max(least, len(peaks) // 2))
    if rival >= _RIVAL * best.score:
        raise CalibrationError(
            f"two dispersions explain the peaks equally well ({best.score:.1f} and {rival:.1f} of {len(peaks)}).",
            hint="tell more of the instrument: a narrower range of dispersions, or of the first wavelength",
        )
    pairs = np.argsort(order[best.peak], kind="stable")
    return Assignment(order[best.peak][pairs], best.line[pairs], best.dispersion, best.score, rival)


def _nothing_fits(least: int) -> CalibrationError:
    return CalibrationError(
        f"no dispersion puts {least} of the peaks on lines.",
        hint="is it this lamp, the background subtracted, and the range of dispersions right?",
    )


def _straight(peaks: Floats, known: Floats, prior: DispersionRange, seed: int) -> list[tuple[float, float]]:
    """The most promising straight dispersions, best first: wavelength at band 0, and nm a band."""
    left, right = np.triu_indices(len(peaks), 1)
    low, high = np.triu_indices(len(known), 1)
    if prior.nm_per_band[0] < 0:
        low, high = high, low
    wide = (peaks[right] - peaks[left]) > 0.1 * np.ptp(peaks)
    left, right = left[wide], right[wide]
    slope = (known[high] - known[low])[None, :] / (peaks[right] - peaks[left])[:, None]
    first = known[low][None, :] - slope * peaks[left][:, None]
    possible = (slope >= prior.nm_per_band[0]) & (slope <= prior.nm_per_band[1])
    possible &= (first >= prior.first_nm[0]) & (first <= prior.first_nm[1])
    slope, first = slope[possible], first[possible]
    if len(slope) > _TRIALS:
        chosen = np.random.default_rng(seed).choice(len(slope), _TRIALS, replace=False)
        slope, first = slope[chosen], first[chosen]
    scores = [
        _explained(first[at : at + _BATCH, None] + slope[at : at + _BATCH, None] * peaks, known, prior.bend_nm / 2)
        for at in range(0, len(slope), _BATCH)
    ]
    if not scores:
        return []
    best = np.argsort(-np.concatenate(scores), kind="stable")[: 20 * _KEPT]
    kept: list[tuple[float, float]] = []
    for index in best.tolist():
        here = (float(first[index]), float(slope[index]))
        ends = here[0] + here[1] * peaks[[0, -1]]
        if all(np.abs(ends - (a + b * peaks[[0, -1]])).max() > prior.bend_nm / 4 for a, b in kept):
            kept.append(here)
        if len(kept) == _KEPT:
            break
    return kept


def _explained(expected: Floats, known: Floats, tolerance_nm: float) -> Floats:
    """How many peaks lie on lines, near ones counting more, (trial,): expected wavelengths are (trial, peak)."""
    right = np.clip(np.searchsorted(known, expected), 1, len(known) - 1)
    off = np.minimum(np.abs(expected - known[right]), np.abs(expected - known[right - 1]))
    return np.maximum(1 - (off / tolerance_nm) ** 2, 0).sum(axis=-1)


def _bend(
    peaks: Floats,
    known: Floats,
    first_nm: float,
    slope: float,
    prior: DispersionRange,
    degree: int,
    tolerance_nm: float,
) -> Assignment | None:
    """Bend a straight dispersion to a polynomial through the pairs it makes; None where too few are left."""
    expected = first_nm + slope * peaks
    final: tuple[NDArray[np.intp], NDArray[np.intp], Dispersion] | None = None
    steps = [prior.bend_nm / 2, prior.bend_nm / 2, prior.bend_nm / 3, 1.5 * tolerance_nm, *[tolerance_nm] * 3]
    for index, reach in enumerate(max(step, tolerance_nm) for step in steps):
        peak, line = _pairs(expected, known, reach)
        now = 1 if index == 0 else degree
        if len(peak) < degree + 3:
            return None
        curve = fit_dispersion(peaks[peak], known[line], degree=now)
        if not _possible(curve, peaks, prior):
            return None
        expected, final = curve.nm(peaks), (peak, line, curve)
    assert final is not None
    peak, line, curve = final
    off = curve.nm(peaks[peak]) - known[line]
    score = float(np.sum(1 - (off / tolerance_nm) ** 2 / 2))
    return Assignment(peak, line, curve, score, 0.0)


def _pairs(expected: Floats, known: Floats, reach_nm: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Each peak with at most one line and each line with at most one peak, as near as can be (Hungarian method)."""
    off = np.abs(expected[:, None] - known[None, :])
    pairs = cast("Any", optimize.linear_sum_assignment(np.minimum(off, reach_nm) ** 2))
    peak, line = cast("tuple[NDArray[np.intp], NDArray[np.intp]]", pairs)
    near = off[peak, line] < reach_nm
    return peak[near], line[near]


def _possible(curve: Dispersion, peaks: Floats, prior: DispersionRange) -> bool:
    ends = np.array([peaks[0], peaks[-1]])
    straight = (float(curve.nm(ends[1])) - float(curve.nm(ends[0]))) / max(ends[1] - ends[0], 1e-9)
    margin = 0.05 * (prior.nm_per_band[1] - prior.nm_per_band[0])
    if not prior.nm_per_band[0] - margin <= straight <= prior.nm_per_band[1] + margin:
        return False
    chord = float(curve.nm(ends[0])) + straight * (peaks - ends[0])
    return bool(np.abs(curve.nm(peaks) - chord).max() <= prior.bend_nm)


def _differs(one: Assignment, other: Assignment, peaks: Floats, tolerance_nm: float) -> bool:
    return bool(np.median(np.abs(one.dispersion.nm(peaks) - other.dispersion.nm(peaks))) > 2 * tolerance_nm)
