"""How many buffers a scan needs, from the stalls of its storage."""

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
