"""The two laws of a line's time, fitted to measured periods.

* **additive** (Eqs. 1 and 3): ``T_line = T + T_extra``, efficiency ``T / (T + T_extra)``: an instrument that does all in turn.
* **overlapped**: ``T_line = max(T + a, c)``: what cannot overlap the exposure adds ``a``, the slowest of the rest is ``c``.

Both are fitted by least squares on the line periods, because the spread of a line's period does not depend on its exposure; the
efficiency curves are the same laws. Intervals are of 95 %, from a circular block bootstrap over the lines of each scan: delays of
neighbouring lines are not independent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_REPLICATES: Final = 1000
_BLOCK: Final = 10
_LEVELS: Final = (2.5, 97.5)
_RESOLVED_S: Final = 1e-6


@dataclass(frozen=True, slots=True)
class Estimate:
    """A parameter in s with its 95 % interval."""

    value: float
    low: float
    high: float

    def __contains__(self, value: float) -> bool:
        return self.low <= value <= self.high

    def __str__(self) -> str:
        """In ms, with the half width of the interval."""
        value = round(self.value * 1e3, 2) + 0.0  # no minus before a zero
        return f"{value:.2f} ± {(self.high - self.low) / 2 * 1e3:.2f}"


@dataclass(frozen=True, slots=True)
class Law:
    """A fitted law.

    Attributes:
        overlapped: Which of the two laws it is.
        added: T_extra of an additive law, a of an overlapped one.
        floor: c of an overlapped law; None where the law is additive or no exposure was short enough to meet the floor.
        r2: Share of the variance of lines per second that the law explains.
    """

    overlapped: bool
    added: Estimate
    floor: Estimate | None
    r2: float

    def period_s(self, exposure_s: Floats) -> Floats:
        """Line period for exposures in s."""
        period = exposure_s + self.added.value
        return period if self.floor is None else np.maximum(period, self.floor.value)

    def efficiency(self, exposure_s: float) -> float:
        """Part of the time that is exposure (Eq. 3)."""
        return exposure_s / float(self.period_s(np.array([exposure_s]))[0])

    @property
    def limit_lps(self) -> float | None:
        """Lines per second as the exposure goes to 0; None where the floor that would set it was not met, or is 0."""
        period_s = float(self.period_s(np.zeros(1))[0])
        return None if (self.overlapped and self.floor is None) or period_s <= 0 else 1 / period_s


def fit_additive(exposures_s: Sequence[float], periods_s: Sequence[Floats]) -> Law:
    """Fit ``T_line = T + T_extra``.

    Args:
        exposures_s: Of each scan.
        periods_s: Line periods of each scan, float64 (lines,).
    """
    exposure, means, drawn = _prepared(exposures_s, periods_s)
    added = _estimate((means - exposure).mean(), (drawn - exposure).mean(axis=1))
    return Law(False, added, None, _r2(1 / means, 1 / (exposure + added.value)))


def fit_overlapped(exposures_s: Sequence[float], periods_s: Sequence[Floats]) -> Law:
    """Fit ``T_line = max(T + a, c)``: the best of all ways to divide the exposures into those at the floor and those above it.

    A floor that cannot be told from ``T + a`` of the shortest exposure is none: one point more or less fits by chance.

    Args:
        exposures_s: Of each scan.
        periods_s: Line periods of each scan, float64 (lines,).
    """
    exposure, means, drawn = _prepared(exposures_s, periods_s)
    best, replicates = _divide(exposure, means[None, :]), _divide(exposure, drawn)
    added, floor = (
        _estimate(float(value[0]), drawn_value[np.isfinite(drawn_value)])
        for value, drawn_value in zip(best, replicates, strict=True)
    )
    if not floor.low > exposure[0] + added.high + _RESOLVED_S:
        added, floor = _estimate((means - exposure).mean(), (drawn - exposure).mean(axis=1)), None
    law = Law(True, added, floor, 1.0)
    return replace(law, r2=_r2(1 / means, 1 / law.period_s(exposure)))


def _divide(exposure: Floats, periods: Floats) -> tuple[Floats, Floats]:
    """a and c for each row of periods (n, exposures); c is nan where no exposure lies at the floor."""
    best = np.full(len(periods), np.inf)
    added, floor = np.zeros(len(periods)), np.full(len(periods), np.nan)
    for low in range(len(exposure)):
        a = (periods[:, low:] - exposure[low:]).mean(axis=1)
        c = periods[:, :low].mean(axis=1) if low else np.full(len(periods), np.nan)
        misfit = ((periods - np.fmax(exposure + a[:, None], c[:, None])) ** 2).sum(axis=1)
        better = misfit < best * (1 - 1e-9)
        best[better], added[better], floor[better] = misfit[better], a[better], c[better]
    return added, floor


def _prepared(exposures_s: Sequence[float], periods_s: Sequence[Floats]) -> tuple[Floats, Floats, Floats]:
    """Exposures in ascending order, their mean periods, and bootstrap replicates of these (replicates, exposures)."""
    order = np.argsort(exposures_s, kind="stable")
    exposure = np.asarray(exposures_s, np.float64)[order]
    ordered: list[Floats] = [periods_s[place] for place in order.tolist()]
    rng = np.random.default_rng(0)
    means = np.array([float(periods.mean()) for periods in ordered])
    return exposure, means, np.stack([_resampled(periods, rng) for periods in ordered], axis=1)


def _resampled(periods: Floats, rng: np.random.Generator) -> Floats:
    """Mean periods of replicates made of blocks of neighbouring lines, float64 (replicates,).

    Blocks of b out of n lines spread too little, by (n - b) / n in variance; that is made good here.
    """
    count = len(periods)
    block = max(1, min(_BLOCK, count // 5))
    begins = rng.integers(0, count, (_REPLICATES, -(-count // block), 1))
    places = (begins + np.arange(block)).reshape(_REPLICATES, -1)[:, :count] % count
    mean = periods.mean()
    return mean + (periods[places].mean(axis=1) - mean) * np.sqrt(count / max(count - block, 1))


def _estimate(value: float, drawn: Floats) -> Estimate:
    low, high = np.percentile(drawn, _LEVELS).tolist() if len(drawn) else (float("nan"), float("nan"))
    return Estimate(float(value), low, high)


def _r2(measured: Floats, fitted: Floats) -> float:
    spread = float(((measured - measured.mean()) ** 2).sum())
    return 1 - float(((measured - fitted) ** 2).sum()) / spread if spread else float("nan")
