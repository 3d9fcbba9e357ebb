"""What the steps compute, bound to a signal: each by itself, as plainly as it can be said.

A pipeline puts those that are sums along the bands together (`scanhsi.processing.banded`) instead of calling them one by one; these
are what that has to come to.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from scanhsi.processing.banded import Banded

Values = NDArray[Any]
Bound = Callable[[Values], Values]
"""Computes some whole lines, (band, line, sample), from any thread or process."""

_FLOAT: Final = np.dtype(np.float32)


@dataclass(frozen=True, slots=True)
class Masked:
    """Counts to float32; nan from ``level`` on."""

    level: float

    def __call__(self, lines: Values) -> Values:
        """Some lines."""
        values = lines.astype(_FLOAT)
        values[lines >= self.level] = np.nan
        return values


@dataclass(frozen=True, slots=True, eq=False)
class Subtracted:
    """Minus ``dark``, (band, sample)."""

    dark: Values

    def __call__(self, lines: Values) -> Values:
        """Some lines."""
        return np.subtract(lines, self.dark[:, None, :], dtype=_FLOAT)

    def banded(self, bands: int, samples: slice) -> Banded:
        """As a sum along the bands."""
        del bands
        dark = self.dark[:, samples]
        return Banded.scaled(np.ones_like(dark), dark)


@dataclass(frozen=True, slots=True, eq=False)
class Scaled:
    """Times ``factor``, (band, sample); nan where that is."""

    factor: Values

    def __call__(self, lines: Values) -> Values:
        """Some lines."""
        return np.multiply(lines, self.factor[:, None, :], dtype=_FLOAT)

    def banded(self, bands: int, samples: slice) -> Banded:
        """As a sum along the bands."""
        del bands
        factor = self.factor[:, samples]
        return Banded.scaled(factor, np.zeros_like(factor))


@dataclass(frozen=True, slots=True)
class Means:
    """Means of ``rows`` neighbouring bands; a shorter rest at the end is one, too."""

    rows: int

    def __call__(self, lines: Values) -> Values:
        """Some lines."""
        return means(self.rows, lines)

    def banded(self, bands: int, samples: slice) -> Banded:
        """As a sum along the bands."""
        return Banded.means(self.rows, bands, samples.stop - samples.start)


def same(lines: Values) -> Values:
    """Nothing is done."""
    return lines


def means(rows: int, values: Values) -> Values:
    """Means of so many neighbours along the first axis, float32 of integers."""
    starts = np.arange(0, len(values), rows)
    counts = np.diff(np.append(starts, len(values))).reshape(-1, *[1] * (values.ndim - 1))
    found = np.add.reduceat(values, starts, axis=0) / counts
    return found.astype(values.dtype if values.dtype.kind == "f" else _FLOAT, copy=False)
