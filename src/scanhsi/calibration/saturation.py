"""Where a sensor saturates: at full scale, or at a plateau below it, which no data sheet tells.

A camera whose pixels fill up before its converter does gives many pixels one and the same large value that is not full scale (57351
of 65535, in a published case). In the histogram of the counts that is a spike at its upper end.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

_LEAST_SHARE: Final = 1e-4
_TIMES_MORE: Final = 20.0
_NEAR: Final = 64  # values below the spike that it is compared with


class Histogram:
    """Counts how often each value occurs, over any number of frames, in constant memory."""

    def __init__(self, full_scale: int) -> None:
        """Args: full_scale, the largest value there can be."""
        self.full_scale = full_scale
        self.counts: NDArray[np.int64] = np.zeros(full_scale + 1, np.int64)

    def add(self, frame: NDArray[Any]) -> None:
        """Take some pixels."""
        self.counts += np.bincount(frame.ravel(), minlength=self.full_scale + 1)[: self.full_scale + 1]

    def plateau(self) -> int | None:
        """The value at which pixels pile up below full scale; None where they do not."""
        occupied = np.flatnonzero(self.counts)
        if not occupied.size:
            return None
        top = int(occupied[-1])
        return _plateau(top, self.counts[max(0, top - _NEAR) : top + 1], int(self.counts.sum()), self.full_scale)


class TopCounts:
    """The upper end of a histogram: all that a plateau is told by, at a tenth of the work. Two can be added.

    Attributes:
        top: The largest value so far; -1 before the first.
        total: Pixels so far.
    """

    def __init__(self, full_scale: int) -> None:
        """Args: full_scale, the largest value there can be."""
        self.full_scale = full_scale
        self.top = -1
        self.total = 0
        self._counts: NDArray[np.int64] = np.zeros(_NEAR + 1, np.int64)  # of the values up to top

    def add(self, pixels: NDArray[Any]) -> None:
        """Take some pixels."""
        largest = int(pixels.max())
        self._raise_to(largest)
        self.total += pixels.size
        least = self.top - _NEAR
        if largest >= least:
            near = pixels[pixels >= max(least, 0)].astype(np.int64) - least
            self._counts += np.bincount(near, minlength=_NEAR + 1)

    def merge(self, other: TopCounts) -> None:
        """Take what another one has seen."""
        self._raise_to(other.top)
        self.total += other.total
        lower = self.top - other.top
        if lower <= _NEAR:
            self._counts[: _NEAR + 1 - lower] += other._counts[lower:]

    def plateau(self) -> int | None:
        """As of `Histogram`."""
        counts = self._counts[max(0, _NEAR - self.top) :]
        return _plateau(self.top, counts, self.total, self.full_scale) if self.total else None

    def _raise_to(self, top: int) -> None:
        higher = top - self.top
        if higher > 0:
            self._counts = np.concatenate((self._counts, np.zeros(min(higher, _NEAR + 1), np.int64)))[-_NEAR - 1 :]
            self.top = top


def _plateau(top: int, counts: NDArray[np.int64], total: int, full_scale: int) -> int | None:
    """The largest value, if pixels pile up there below full scale. ``counts`` are of the values up to it."""
    near, peak = counts[:-1], int(counts[-1])
    usual = max(float(near.mean()), 1.0) if near.size else 1.0
    dark = top < full_scale / 8  # nothing saturates there: a dark frame that hardly varies
    found = top < full_scale and peak >= max(_LEAST_SHARE * total, _TIMES_MORE * usual) and not dark
    return top if found else None
