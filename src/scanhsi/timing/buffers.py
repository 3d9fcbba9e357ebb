"""How many buffers a scan needs, from the stalls of its storage; how close to a stage's mean a sweep may come, from its buffers."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray


def buffers_for_stall(latency_s: float, period_s: float, stall_s: float) -> int:
    """Buffers with which a stall costs neither time nor lines: ceil(L / period) + ceil(stall / period) + 1.

    Args:
        latency_s: From the start of an exposure to its line stored, without the stall.
        period_s: Line period to be kept.
        stall_s: Longest lateness of the writer; `longest_lateness_s` has it from measurements.
    """
    return math.ceil(latency_s / period_s - 1e-9) + math.ceil(stall_s / period_s - 1e-9) + 1


def longest_lateness_s(store_ns: NDArray[np.int64], period_s: float) -> float:
    """How far a writer with these times per line falls behind a scan with this period, at worst, in s.

    One long stall counts as itself, several in a row add up: q_k = max(q_(k-1) + store_k - period, 0) (Lindley).

    Args:
        store_ns: Time that storage took for each line, in line order, ns, int64 (n,).
        period_s: Line period.
    """
    if not len(store_ns):
        return 0.0
    behind = np.concatenate(([0.0], np.cumsum(np.asarray(store_ns, np.float64) * 1e-9 - period_s)))
    return float(np.max(behind - np.minimum.accumulate(behind)))


def levelled_period_s(mean_s: float, spread_s: float, frames: int, *, risk: float = 1e-9) -> float:
    """Shortest line period at which a queue levels out a stage of random duration: mean + spread^2 ln(1 / risk) / (2 frames mean).

    What waits before the stage is a random walk with a drift of mean - period a line. It ever climbs above ``frames`` times the
    mean with a probability of at most exp(-2 drift frames mean / spread^2) (Cramer and Lundberg's bound, in the diffusion limit).
    So a little above the mean is enough, for a scan of any length; without a queue it would have to be a high quantile.

    Args:
        mean_s: Of the stage's duration.
        spread_s: Its standard deviation over many lines; see `long_run_spread_s`.
        frames: That may wait.
        risk: Probability that a frame finds the queue full.
    """
    return mean_s + spread_s**2 * math.log(1 / risk) / (2 * frames * mean_s)


def long_run_spread_s(durations_ns: NDArray[np.int64], block: int = 64) -> float:
    """Standard deviation of sums of durations, for one line: larger than that of single lines where long ones come together.

    Args:
        durations_ns: In line order, int64 (n,), ns; n should be many blocks.
        block: Lines over which neighbours have something in common.
    """
    whole = len(durations_ns) // block * block
    sums = durations_ns[:whole].reshape(-1, block).sum(1) * 1e-9
    return float(sums.std()) / math.sqrt(block)
