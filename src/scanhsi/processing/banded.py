"""Sums along the bands: what dark, white, smile and binning have in common, and so can be done as one.

Each of these makes a number from a few neighbouring bands of the same sample: a weighted sum minus a constant. One after the other
they are such a sum again. `Banded` is one, worked out in float64; `Banded.after` puts two together; `scanhsi.processing.kernel`
computes it. What cannot be known is kept apart from the weights: which bands a number takes in, so that it is nan where one of
them is, and a constant of nan where it is never known.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final, Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_NOWHERE: Final = 1 << 30


@dataclass(frozen=True, slots=True, eq=False)
class Banded:
    """``out[c, s] = sum over k of weight[k, c, s] in[first[c, s] + k, s], minus offset[c, s]``.

    Attributes:
        bands: Of what goes in. What ``first + k`` finds beyond them has no weight.
        first: (channel, sample).
        weight: (tap, channel, sample), finite.
        takes: Whether a tap is taken in, (tap, channel, sample): a number is nan where one of these is. Where not, no weight.
        offset: (channel, sample); nan: never known.
    """

    bands: int
    first: NDArray[np.intp]
    weight: Floats
    takes: NDArray[np.bool_]
    offset: Floats

    @classmethod
    def scaled(cls, factor: NDArray[Any], offset: NDArray[Any]) -> Self:
        """``factor * in - offset``, (band, sample); never known where one of them is nan."""
        known = np.isfinite(factor) & np.isfinite(offset)
        return cls(
            bands=len(factor),
            first=_rows(*factor.shape),
            weight=np.where(known, factor, 0.0)[None].astype(np.float64),
            takes=known[None],
            offset=np.where(known, offset, np.nan).astype(np.float64),
        )

    @classmethod
    def means(cls, rows: int, bands: int, samples: int) -> Self:
        """Means of so many neighbours; a shorter rest at the end is a mean too."""
        channels = -(-bands // rows)
        takes = (np.arange(channels) * rows + np.arange(rows)[:, None] < bands)[..., None]
        weight = takes / takes.sum(axis=0)
        shape = (rows, channels, samples)
        return cls(
            bands=bands,
            first=rows * _rows(channels, samples),
            weight=np.broadcast_to(weight, shape),
            takes=np.broadcast_to(takes, shape),
            offset=np.zeros((channels, samples)),
        )

    @property
    def shape(self) -> tuple[int, int]:
        """(channels, samples) of what comes out."""
        return self.first.shape

    def after(self, inner: Banded) -> Banded:
        """This, of what another one makes."""
        taps = [_Chosen(self, tap, inner) for tap in range(len(self.weight))]
        first = np.min([chosen.begin for chosen in taps], axis=0)
        first[first == _NOWHERE] = 0  # takes nothing in
        reach = max(chosen.reach(first) for chosen in taps)
        weight = np.zeros((reach + len(inner.weight), *self.shape))
        takes = np.zeros(weight.shape, np.bool_)
        offset = self.offset.copy()
        for chosen in taps:
            offset += chosen.offset()
            for moved, here in chosen.moved(first):
                for index in range(len(inner.weight)):
                    chosen.add(index, here, weight[moved + index], takes[moved + index])
        return Banded(inner.bands, first, weight, takes, offset)


class _Chosen:
    """What one tap of a sum takes of another sum that comes before."""

    def __init__(self, outer: Banded, tap: int, inner: Banded) -> None:
        self._inner = inner
        self._weight, self._takes = outer.weight[tap], outer.takes[tap]
        row = np.clip(outer.first + tap, 0, outer.bands - 1)
        self._row = None if row.shape == inner.shape and (row == _rows(*row.shape)).all() else row
        self.begin = np.where(
            self._takes & self._of(np.logical_or.reduce(inner.takes)), self._of(inner.first), _NOWHERE
        )

    def _of(self, values: NDArray[Any]) -> NDArray[Any]:
        return values if self._row is None else np.take_along_axis(values, self._row, axis=0)

    def reach(self, first: NDArray[np.intp]) -> int:
        """The last tap of the two at which this one begins."""
        return int(self._later(first).max(initial=0))

    def _later(self, first: NDArray[np.intp]) -> NDArray[np.intp]:
        return np.where(self.begin == _NOWHERE, -1, self.begin - first)

    def moved(self, first: NDArray[np.intp]) -> Iterator[tuple[int, NDArray[np.bool_]]]:
        """By how many taps of the two it begins later, and where."""
        later = self._later(first)
        for moved in range(int(later.max()) + 1):
            here = later == moved
            if here.any():
                yield moved, here

    def offset(self) -> Floats:
        """What it adds to the constant."""
        return np.where(self._takes, self._weight * self._of(self._inner.offset), 0.0)

    def add(self, index: int, here: NDArray[np.bool_], weight: Floats, takes: NDArray[np.bool_]) -> None:
        """Add a tap of the inner sum, where it begins so."""
        taken = here & self._of(self._inner.takes[index])
        weight += self._weight * self._of(self._inner.weight[index]) * taken
        takes |= taken


@runtime_checkable
class AlongBands(Protocol):
    """A function of lines that may be a sum along the bands."""

    def banded(self, bands: int, samples: slice) -> Banded | None:
        """Of lines of so many bands, for some samples, from one to one; None if it is no such sum."""
        ...


def _rows(channels: int, samples: int) -> NDArray[np.intp]:
    return np.broadcast_to(np.arange(channels, dtype=np.intp)[:, None], (channels, samples))
