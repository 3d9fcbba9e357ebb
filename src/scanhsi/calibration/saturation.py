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
        if not occupied.size or occupied[-1] == self.full_scale:
            return None
        top = int(occupied[-1])
        near = self.counts[max(0, top - _NEAR) : top]
        usual = max(float(near.mean()), 1.0) if near.size else 1.0
        share = self.counts[top] / self.counts.sum()
        dark = top < self.full_scale / 8  # nothing saturates there: a dark frame that hardly varies
        return top if share >= _LEAST_SHARE and self.counts[top] >= _TIMES_MORE * usual and not dark else None
