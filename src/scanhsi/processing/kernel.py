"""Computes a sum along the bands on lines of the camera, in one pass and in the processor's cache.

The channels are cut into blocks. For each, the weights are gathered once, in float32 and in the order in which they are used; then
line after line is brought to float32, block by block in a buffer that stays in the cache, and multiplied and summed by
`numpy.einsum`, which needs no intermediate result and does not hold the interpreter. A line comes out the same bit for bit,
whichever lines go with it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray

from scanhsi.processing.banded import Banded

_BLOCK_ROWS: Final = 96  # bands of the buffer: with its weights it is to fit the second cache
_CELL: Final = 64  # samples that share where their sums begin, at least
_FAR: Final = 1 << 30


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """Samples of a block whose sums begin at the same band.

    Attributes:
        samples: Which.
        first: Row of the block's buffer where the first channel's sum begins.
        weight: (tap, channel, sample) float32.
        takes: (tap, channel, sample) uint8, 1 where a tap is taken in.
    """

    samples: slice
    first: int
    weight: NDArray[np.float32]
    takes: NDArray[np.uint8]


@dataclass(frozen=True, slots=True, eq=False)
class _Block:
    """Some channels.

    Attributes:
        channels: Which.
        rows: Rows of the buffer that they need.
        source: Bands that are put there, and where.
        place: Rows of the buffer that get them; the others stay zero.
        parts: Along the samples.
        offset: (channel, sample) float32.
    """

    channels: slice
    rows: int
    source: slice
    place: slice
    parts: tuple[_Part, ...]
    offset: NDArray[np.float32]


class Kernel:
    """A `Banded` of lines as they come: counts, of which those from a level on are not known, or floats with nan.

    Made once, used on any number of lines and from any thread.
    """

    def __init__(self, banded: Banded, level: float = np.inf) -> None:
        """Gather the weights.

        Args:
            banded: What is computed.
            level: Numbers from here on are not known.
        """
        channels = banded.shape[0]
        self._shape = banded.shape
        self._level = level
        self._step = max(1, round(float(np.median(np.diff(banded.first, axis=0))))) if channels > 1 else 1
        at_once = max(1, _BLOCK_ROWS // self._step)
        blocks = (slice(start, min(start + at_once, channels)) for start in range(0, channels, at_once))
        self._blocks = [_block(banded, block, self._step) for block in blocks]

    def __call__(self, lines: NDArray[Any]) -> NDArray[np.float32]:
        """Compute some lines: (band, line, sample) -> (channel, line, sample) float32."""
        samples, count = self._shape[1], lines.shape[1]
        out = np.empty((count, self._shape[0], samples), np.float32)
        unknown = (
            [self._unknown(lines[:, line]) for line in range(count)] if self._some_unknown(lines) else [None] * count
        )
        for block in self._blocks:
            buffer = np.zeros((block.rows, samples), np.float32)
            for line in range(count):
                bad = unknown[line]
                _fill(buffer, block, lines[block.source, line], None if bad is None else bad[block.source])
                made = out[line, block.channels]
                self._sum(buffer, block, [part.weight for part in block.parts], made)
                made -= block.offset
                if bad is not None and (there := bad[block.source]).any():
                    made[self._taken_in(block, there)] = np.nan
        return out.transpose(1, 0, 2)

    def _some_unknown(self, lines: NDArray[Any]) -> bool:
        if lines.dtype.kind == "f":
            return bool(np.isnan(lines.max())) or bool((lines >= self._level).any())  # a maximum takes nan along
        return self._level < np.inf and bool(lines.max() >= self._level)

    def _unknown(self, line: NDArray[Any]) -> NDArray[np.bool_] | None:
        bad = line >= self._level
        if line.dtype.kind == "f":
            bad |= np.isnan(line)
        return bad if bad.any() else None

    def _taken_in(self, block: _Block, unknown: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Where an unknown number is taken in, (channel, sample)."""
        buffer = np.zeros((block.rows, self._shape[1]), np.uint8)
        buffer[block.place] = unknown
        taken = np.empty(block.offset.shape, np.uint8)
        self._sum(buffer, block, [part.takes for part in block.parts], taken)
        return taken > 0

    def _sum(self, buffer: NDArray[Any], block: _Block, weights: list[NDArray[Any]], out: NDArray[Any]) -> None:
        down, right = buffer.strides
        for part, weight in zip(block.parts, weights, strict=True):
            begin = buffer[part.first :, part.samples]
            taps = as_strided(begin, weight.shape, (down, self._step * down, right), writeable=False)
            np.einsum("kcs,kcs->cs", taps, weight, out=out[:, part.samples])


def _fill(buffer: NDArray[np.float32], block: _Block, rows: NDArray[Any], unknown: NDArray[np.bool_] | None) -> None:
    there = buffer[block.place]
    np.copyto(there, rows)
    if unknown is not None and rows.dtype.kind == "f":
        there[unknown] = 0  # nan times no weight would be nan


def _block(banded: Banded, channels: slice, step: int) -> _Block:
    ahead: NDArray[np.intp] = step * np.arange(channels.stop - channels.start, dtype=np.intp)[:, None]
    begins, takes = banded.first[channels] - ahead, banded.takes[:, channels]
    place: NDArray[np.intp] = begins + np.arange(len(takes), dtype=np.intp)[:, None, None]
    low, high = place.min(axis=(0, 1), where=takes, initial=_FAR), place.max(axis=(0, 1), where=takes, initial=-_FAR)
    nothing = low > high
    low[nothing] = high[nothing] = begins[0, nothing]
    runs = list(_runs(low, high))
    start = min(begin for _, begin, _ in runs)
    stop = max(end for _, _, end in runs) + 1 + int(ahead[-1, 0])
    source = slice(*np.clip((start, stop), 0, banded.bands).tolist())
    parts = tuple(_part(banded, channels, begins, start, run) for run in runs)
    there = slice(source.start - start, source.stop - start)
    return _Block(channels, stop - start, source, there, parts, banded.offset[channels].astype(np.float32))


def _runs(low: NDArray[np.intp], high: NDArray[np.intp]) -> Iterator[tuple[slice, int, int]]:
    """Samples that share a window: cells of some, joined where that widens no window."""
    cells = [slice(start, min(start + _CELL, len(low))) for start in range(0, len(low), _CELL)]
    first, begin, end = 0, int(low[cells[0]].min()), int(high[cells[0]].max())
    for cell in cells[1:]:
        lower, higher = int(low[cell].min()), int(high[cell].max())
        joined = max(end, higher) - min(begin, lower)
        if joined <= max(end - begin, higher - lower):
            begin, end = min(begin, lower), max(end, higher)
            continue
        yield slice(first, cell.start), begin, end
        first, begin, end = cell.start, lower, higher
    yield slice(first, len(low)), begin, end


def _part(banded: Banded, channels: slice, begins: NDArray[np.intp], start: int, run: tuple[slice, int, int]) -> _Part:
    """Weights of a run of samples, moved to where its window begins."""
    samples, begin, end = run
    shape = (end + 1 - begin, len(begins), samples.stop - samples.start)
    weight, takes = np.zeros(shape, np.float32), np.zeros(shape, np.uint8)
    for tap in range(len(banded.takes)):
        taken = np.nonzero(banded.takes[tap, channels, samples])
        at = (begins[:, samples] + tap - begin)[taken]
        weight[at, *taken] = banded.weight[tap, channels, samples][taken]
        takes[at, *taken] = 1
    return _Part(samples, begin - start, weight, takes)
