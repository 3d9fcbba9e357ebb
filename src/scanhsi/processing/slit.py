"""Computes a sum along the slit, on lines of floats: `scanhsi.processing.kernel`, turned by a right angle.

Bands are taken in blocks that stay in the processor's cache; a number takes in a few neighbouring samples of its own band.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray

from scanhsi.processing.kernel import runs

Floats = NDArray[np.float64]

Neighbours = tuple[NDArray[np.intp], Floats, NDArray[np.bool_]]
"""First sample taken in, (band, sample); weights of it and those behind it, (tap, band, sample); and what is never known."""

_BLOCK_ROWS: Final = 32


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """Samples of some bands that take in the same neighbours.

    Attributes:
        samples: Which.
        first: The first neighbour, from the sample itself.
        weight: (tap, band, sample) float32.
        takes: (tap, band, sample) uint8, 1 where a neighbour is taken in.
        never: (band, sample), what is never known.
    """

    samples: slice
    first: int
    weight: NDArray[np.float32]
    takes: NDArray[np.uint8]
    never: NDArray[np.bool_]


class SlitKernel:
    """Sums of neighbouring samples; nan where one of them is. Used on any number of lines and from any thread."""

    def __init__(self, bands: int, neighbours: Callable[[slice], Neighbours]) -> None:
        """Gather the weights.

        Args:
            bands: Of a line.
            neighbours: What is taken in, of some bands.
        """
        blocks = (slice(start, min(start + _BLOCK_ROWS, bands)) for start in range(0, bands, _BLOCK_ROWS))
        self._blocks = [(rows, list(_parts(*neighbours(rows)))) for rows in blocks]
        parts = [part for _, parts in self._blocks for part in parts]
        self._left = max(0, -min(part.first + part.samples.start for part in parts))
        last = max(part.first + len(part.weight) + part.samples.stop - 1 for part in parts)
        self._right = max(0, last - max(part.samples.stop for part in parts))

    def __call__(self, lines: NDArray[np.floating[Any]]) -> NDArray[np.float32]:
        """Compute some lines, (band, line, sample) float32."""
        bands, count, samples = lines.shape
        out = np.empty((count, bands, samples), np.float32)
        for rows, parts in self._blocks:
            room = np.zeros((rows.stop - rows.start, self._left + samples + self._right), np.float32)
            inner = room[:, self._left : self._left + samples]
            taps = [self._tap(room, part) for part in parts]
            for line in range(count):
                values, made = lines[rows, line], out[line, rows]
                np.copyto(inner, values)
                unknown = np.isnan(values)
                some_unknown = bool(unknown.any())
                if some_unknown:
                    inner[unknown] = 0  # nan times no weight would be nan
                for part, taken in zip(parts, taps, strict=True):
                    there = made[:, part.samples]
                    _add_up(taken, part.weight, there)
                    there[part.never] = np.nan
                if some_unknown:
                    made[self._taken_in(parts, unknown)] = np.nan
        return out.transpose(1, 0, 2)

    def _tap(self, room: NDArray[Any], part: _Part) -> NDArray[Any]:
        """What a part takes in, a (tap, band, sample) view."""
        down, right = room.strides
        begin = room[:, self._left + part.samples.start + part.first :]
        return as_strided(begin, part.weight.shape, (right, down, right), writeable=False)

    def _taken_in(self, parts: Sequence[_Part], unknown: NDArray[np.bool_]) -> NDArray[np.bool_]:
        bands, samples = unknown.shape
        room = np.zeros((bands, self._left + samples + self._right), np.uint8)
        room[:, self._left : self._left + samples] = unknown
        taken = np.empty(unknown.shape, np.uint8)
        for part in parts:
            _add_up(self._tap(room, part), part.takes, taken[:, part.samples])
        return taken > 0


def _add_up(taps: NDArray[Any], weight: NDArray[Any], out: NDArray[Any]) -> None:
    """What `numpy.einsum` would do with its innermost loop over the taps: they lie as close as the samples do."""
    np.multiply(taps[0], weight[0], out=out)
    product = np.empty_like(out)
    for tap in range(1, len(weight)):
        np.multiply(taps[tap], weight[tap], out=product)
        np.add(out, product, out=out)


def _parts(first: NDArray[np.intp], weight: Floats, never: NDArray[np.bool_]) -> Iterator[_Part]:
    """Of some bands."""
    offset = first - np.arange(first.shape[1], dtype=np.intp)
    takes = weight != 0
    place = offset + np.arange(len(weight), dtype=np.intp)[:, None, None]
    far = offset.shape[1]
    low, high = place.min(axis=(0, 1), where=takes, initial=far), place.max(axis=(0, 1), where=takes, initial=-far)
    nothing = low > high
    low[nothing] = high[nothing] = 0
    for samples, begin, end in runs(low, high):
        shape = (end + 1 - begin, len(offset), samples.stop - samples.start)
        gathered, taken = np.zeros(shape, np.float32), np.zeros(shape, np.uint8)
        for tap in range(len(weight)):
            there = np.nonzero(takes[tap, :, samples])
            at = (place[tap, :, samples] - begin)[there]
            gathered[at, *there] = weight[tap, :, samples][there]
            taken[at, *there] = 1
        yield _Part(samples, begin, gathered, taken, never[:, samples])
