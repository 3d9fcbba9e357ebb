"""Whether two samples come from one distribution: Anderson and Darling's test, its p value by permutation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

_PERMUTATIONS: Final = 1999
_CHUNK: Final = 100
_SEED: Final = 20190409


@dataclass(frozen=True, slots=True)
class Difference:
    """How two samples differ.

    Attributes:
        distance: Largest distance of their distribution functions (Kolmogorov and Smirnov's D), 0 to 1.
        p: Probability of a difference as large or larger if both were of one distribution.
        visible: Distance from which on samples of this size would mostly be told apart (5 % level, large-sample formula).
    """

    distance: float
    p: float
    visible: float


def two_sample(first: NDArray[Any], second: NDArray[Any]) -> Difference:
    """Compare two samples of independent values.

    Anderson and Darling's statistic gives the tails more weight than Kolmogorov and Smirnov's. Its p value comes from
    1999 shuffles of all values, which is exact for small samples and for ties, and always the same.

    Args:
        first: Values, shape (n,), at least one.
        second: Values, shape (m,), at least one.
    """
    n, m = len(first), len(second)
    values, places = np.unique(np.concatenate((first, second)), return_inverse=True)
    order = np.argsort(places, kind="stable")
    ends = np.cumsum(np.bincount(places, minlength=len(values)))
    of_first = (np.arange(n + m) < n)[order].astype(np.float64)
    passed = np.cumsum(of_first)[ends - 1]
    distance = float(np.max(np.abs(passed / n - (ends - passed) / m)))
    visible = min(1.36 * float(np.sqrt((n + m) / (n * m))), 1.0)
    if len(values) == 1:
        return Difference(0.0, 1.0, visible)
    found = _statistic(of_first[None], ends, n)[0]
    generator = np.random.default_rng(_SEED)
    larger, left = 0, _PERMUTATIONS
    while left:
        rows = min(left, _CHUNK)
        shuffled = generator.permuted(np.broadcast_to(of_first, (rows, n + m)), axis=1)
        larger += int(np.count_nonzero(_statistic(shuffled, ends, n) >= found * (1 - 1e-12)))
        left -= rows
    return Difference(distance, (larger + 1) / (_PERMUTATIONS + 1), visible)


def _statistic(of_first: NDArray[np.float64], ends: NDArray[np.intp], n: int) -> NDArray[np.float64]:
    """Scholz and Stephens, *J. Am. Stat. Assoc.* 82, 918 (1987), eq. 6, but for a constant factor: (rows,) from (rows, values)."""
    passed = np.cumsum(of_first, axis=1)[:, ends[:-1] - 1]
    below, total = ends[:-1].astype(np.float64), float(ends[-1])
    weight = np.diff(ends, prepend=0)[:-1] / (below * (total - below))
    return ((total * passed - n * below) ** 2 * weight).sum(axis=1)
