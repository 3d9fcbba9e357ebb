"""Stability of the light: how a lamp settles, drifts and flickers (figure 12, right).

A lamp that was switched on approaches its level exponentially, drifts slowly and flickers. The fit tells when a
measurement may begin, the Allan deviation over which time averaging still helps.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar, cast

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from scanhsi.calibration.result import Provenance, Stored
from scanhsi.devices.errors import CalibrationError

Floats = NDArray[np.float64]

_LEAST_SNAPSHOTS = 8


@dataclass(frozen=True, slots=True, eq=False)
class LightStability:
    """How steady the light is.

    Attributes:
        level: It settles at this, in the unit of what was given.
        overshoot: Relative deviation from the level when the lamp was switched on; positive where it starts brighter.
        settling_s, settling_sigma_s: Time constant, with its standard error; nan where nothing settles.
        drift_per_min: Relative drift a minute, beside the settling; of a lamp that does not settle, over all snapshots.
        stable_after_s: From then on the fit stays within 1 % of the level.
        residual: Relative standard deviation around fit and drift: flicker and noise.
        averaging_s: Averaging times, (averaging,).
        allan: Relative Allan deviation at these, (averaging,).
        time_s, signal: The snapshots: since the lamp was switched on, and their level, (snapshot,).
        provenance: Where it comes from.
    """

    kind: ClassVar[str] = "light"

    level: Annotated[float, Stored("counts", "settled level")]
    overshoot: Annotated[float, Stored("1", "relative deviation at the start")]
    settling_s: Annotated[float, Stored("s", "time constant")]
    settling_sigma_s: Annotated[float, Stored("s", "standard error of the time constant")]
    drift_per_min: Annotated[float, Stored("min-1", "relative drift")]
    stable_after_s: Annotated[float, Stored("s", "within 1 % of the level from then on")]
    residual: Annotated[float, Stored("1", "relative residual")]
    averaging_s: Annotated[Floats, Stored("s", "averaging times", ("averaging",))]
    allan: Annotated[Floats, Stored("1", "relative Allan deviation", ("averaging",))]
    time_s: Annotated[Floats, Stored("s", "since the lamp was switched on", ("snapshot",))]
    signal: Annotated[Floats, Stored("counts", "level of the snapshots", ("snapshot",))]
    provenance: Provenance


def light_stability(time_s: Floats, level: Floats, provenance: Provenance) -> LightStability:
    """Work out the stability from snapshots of an even target.

    Args:
        time_s: Since the lamp was switched on, rising, (snapshot,).
        level: Mean dark-corrected counts, (snapshot,).
        provenance: Where they come from.

    Raises:
        CalibrationError: Fewer than eight snapshots, times that do not rise, values that are no numbers, or no light.
    """
    time_s, level = np.asarray(time_s, np.float64), np.asarray(level, np.float64)
    _check(time_s, level)
    (settled, overshoot, settling, drift, sigma), fitted = _settle(time_s, level)
    averaging, allan = allan_deviation(level / (fitted - settled * drift * time_s), float(np.median(np.diff(time_s))))
    stable = settling * math.log(max(abs(overshoot) / 0.01, 1.0)) if math.isfinite(settling) else float(time_s[0])
    return LightStability(
        level=settled,
        overshoot=overshoot,
        settling_s=settling,
        settling_sigma_s=sigma,
        drift_per_min=60 * drift,
        stable_after_s=stable,
        residual=float(np.std(level / fitted - 1, ddof=4 if math.isfinite(settling) else 2)),
        averaging_s=averaging,
        allan=allan,
        time_s=time_s,
        signal=level,
        provenance=provenance,
    )


def _check(time_s: Floats, level: Floats) -> None:
    if time_s.ndim != 1 or time_s.shape != level.shape or len(time_s) < _LEAST_SNAPSHOTS:
        raise CalibrationError(
            f"light stability needs {_LEAST_SNAPSHOTS} snapshots with their times, or more, not {level.shape}."
        )
    if not (np.isfinite(time_s).all() and np.isfinite(level).all()):
        raise CalibrationError("some snapshots are no numbers: saturated, or never taken.")
    if not (np.diff(time_s) > 0).all():
        raise CalibrationError("the times of the snapshots do not rise.")
    if not level.mean() > 0:
        raise CalibrationError("there is no light in the snapshots.")
    if np.ptp(level) == 0:
        raise CalibrationError("the snapshots do not differ at all: saturated, or all the same one.")


def _settle(time_s: Floats, level: Floats) -> tuple[tuple[float, float, float, float, float], Floats]:
    """Level, relative overshoot, time constant, relative drift a second, error of the time constant, and the curve.

    The level is that at the beginning, drift and overshoot aside. An exponential beside the drift is believed only where it
    explains the snapshots better than the drift alone by the Bayesian criterion.
    """
    begin, rise = cast("list[float]", np.polynomial.polynomial.polyfit(time_s, level, 1).tolist())
    straight = begin + rise * time_s
    flat = (begin, 0.0, math.nan, rise / begin, math.nan), straight
    span = float(time_s[-1] - time_s[0])
    last = float(level[-3:].mean())
    start = (last, float(level[0]) / last - 1, span / 5, 0.0)
    shortest = float(np.diff(time_s).min()) / 5
    try:
        limits = ([0, -np.inf, shortest, -np.inf], [np.inf, np.inf, 10 * span, np.inf])
        scale = (last, 1.0, span, 1 / span)
        fit = cast(
            "tuple[Floats, Floats]",
            optimize.curve_fit(_curve, time_s, level, start, bounds=limits, x_scale=scale, max_nfev=2000),
        )
    except RuntimeError:
        return flat
    best = cast("tuple[float, float, float, float]", tuple(fit[0].tolist()))
    fitted = _curve(time_s, *best)
    n = len(level)
    left, unexplained = float(np.mean((level - fitted) ** 2)), float(np.mean((level - straight) ** 2))
    gained = n * math.log(max(unexplained, 1e-300) / max(left, 1e-300))
    if gained < 2 * math.log(n) + 6:
        return flat
    return (*best, math.sqrt(max(float(fit[1][2, 2]), 0.0))), fitted


def _curve(time_s: Floats, level: float, overshoot: float, settling_s: float, drift: float) -> Floats:
    return level * (1 + overshoot * np.exp(-time_s / settling_s) + drift * time_s)


def allan_deviation(ratio: Floats, interval_s: float) -> tuple[Floats, Floats]:
    """Overlapping Allan deviation of evenly spaced values.

    Returns:
        Averaging times in s, powers of two of the interval up to a quarter of the record, and the deviation at each.
    """
    sums = np.concatenate(([0.0], np.cumsum(ratio)))
    sizes = 2 ** np.arange(max(1, int(math.log2(max(len(ratio) // 4, 1))) + 1))
    deviations: list[float] = []
    for size in sizes.tolist():
        means = (sums[size:] - sums[:-size]) / size
        deviations.append(math.sqrt(float(np.mean((means[size:] - means[:-size]) ** 2)) / 2))
    return sizes.astype(np.float64) * interval_s, np.array(deviations)
