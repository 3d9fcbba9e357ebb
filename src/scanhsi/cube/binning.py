"""Binning on the way in: neighbouring bands, and samples, summed (five pixels a channel, say, as in the paper).

Sums, not means: no bit is lost, and shot noise stays what it is. What does not fill a bin at the end is dropped.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Binning:
    """How many neighbours are summed.

    Raises:
        ValueError: Less than 1.
    """

    bands: int = 1
    samples: int = 1

    def __post_init__(self) -> None:
        if min(self.bands, self.samples) < 1:
            raise ValueError(f"binning sums at least 1 band and sample, not {self.bands} and {self.samples}")

    @property
    def factor(self) -> int:
        """Pixels in a sum."""
        return self.bands * self.samples


NO_BINNING: Final = Binning()


def sum_type(largest: int) -> np.dtype[Any]:
    """The smallest of uint8, uint16 and uint32 that holds ``largest``.

    Raises:
        ValueError: None does.
    """
    for kind in (np.uint8, np.uint16, np.uint32):
        if largest <= np.iinfo(kind).max:
            return np.dtype(kind)
    raise ValueError(f"sums up to {largest} do not fit 32 bits: bin less")


def bin_lines(lines: NDArray[Any], binning: Binning, out: NDArray[Any]) -> None:
    """Sum bins of each line.

    Args:
        lines: (lines, band, sample) as the camera sees them.
        binning: What is summed.
        out: (lines, band // binning.bands, sample // binning.samples), of a type that holds the sums.
    """
    _, bands, samples = out.shape
    for line, summed in zip(lines, out, strict=True):  # line by line: what has been read stays in the cache
        rows = _sum_bands(line, binning.bands, bands, summed if binning.samples == 1 else None)
        if binning.samples > 1:
            columns = rows[:, : samples * binning.samples]
            np.copyto(summed, columns[:, :: binning.samples])
            for offset in range(1, binning.samples):
                np.add(summed, columns[:, offset :: binning.samples], out=summed)


def _sum_bands(line: NDArray[Any], factor: int, bands: int, out: NDArray[Any] | None) -> NDArray[Any]:
    """(bands, sample): sums of ``factor`` bands in ``out``; in memory of their own without it, wide enough for any sum."""
    rows = line[: bands * factor]
    if out is None:
        out = np.empty((bands, line.shape[1]), np.uint32)
    np.copyto(out, rows[::factor])
    for offset in range(1, factor):
        np.add(out, rows[offset::factor], out=out)
    return out
