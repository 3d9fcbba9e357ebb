"""Computes a sum along the bands on lines of the camera, in one pass and in the processor's cache.

The channels are cut into blocks. For each, the weights are gathered once, in float32 and in the order in which they are used; then
line after line is brought to float32, block by block in a buffer that stays in the cache, and multiplied and summed by
`numpy.einsum`, which needs no intermediate result and does not hold the interpreter. A line comes out the same bit for bit,
whichever lines go with it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
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
        first: Band where the sum of the block's first channel begins; may lie before the first one.
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
        start: Band of the buffer's first row.
        rows: Rows of the buffer that they need.
        source: Bands that are put there, and where.
        place: Rows of the buffer that get them; the others stay zero.
        parts: Along the samples.
        offset: (channel, sample) float32.
    """

    channels: slice
    start: int
    rows: int
    source: slice
    place: slice
    parts: tuple[_Part, ...]
    offset: NDArray[np.float32]


class Kernel:
    """A `Banded` of lines as they come: counts, of which those from a level on are not known, or floats with nan.

    Made once, used on any number of lines and from any thread.
    """

    def __init__(self, sums: Iterable[tuple[slice, Banded]], level: float = np.inf) -> None:
        """Gather the weights.

        Args:
            sums: What is computed, some samples after the other: which, and of these.
            level: Numbers from here on are not known.
        """
        self._level = level
        pieces = list[tuple[slice, NDArray[np.float32], list[list[_Part]]]]()
        self._step, self._channels, bands = 1, list[slice](), 0
        for samples, banded in sums:
            if not pieces:
                bands, self._step, self._channels = banded.bands, _step(banded), list(_cut(banded))
            parts = [list(_parts(banded, channels, self._step, samples.start)) for channels in self._channels]
            pieces.append((samples, banded.offset.astype(np.float32), parts))
        offset = np.concatenate([piece for _, piece, _ in pieces], axis=1)
        self._shape = offset.shape
        self._blocks = [
            _block(channels, bands, self._step, [part for _, _, parts in pieces for part in parts[index]], offset)
            for index, channels in enumerate(self._channels)
        ]

    def __call__(self, lines: NDArray[Any]) -> NDArray[np.float32]:
        """Compute some lines: (band, line, sample) -> (channel, line, sample) float32."""
        samples, count = self._shape[1], lines.shape[1]
        out = np.empty((count, self._shape[0], samples), np.float32)
        unknown = (
            [self._unknown(lines[:, line]) for line in range(count)] if self._some_unknown(lines) else [None] * count
        )
        for block in self._blocks:
            buffer = np.zeros((block.rows, samples), np.float32)
            taps = self._taps(buffer, block)
            for line in range(count):
                bad = unknown[line]
                _fill(buffer, block, lines[block.source, line], None if bad is None else bad[block.source])
                made = out[line, block.channels]
                _sum(taps, [part.weight for part in block.parts], block, made)
                made -= block.offset
                if bad is not None and (there := bad[block.source]).any():
                    made[self._taken_in(block, there)] = np.nan
        return out.transpose(1, 0, 2)

    def _some_unknown(self, lines: NDArray[Any]) -> bool:
        if lines.dtype.kind == "f":
            return bool(np.isnan(lines.max())) or bool((lines >= self._level).any())  # a maximum takes nan along
        return self._level < np.inf and bool(lines.max() >= self._level)

    def _unknown(self, line: NDArray[Any]) -> NDArray[np.bool_] | None:
        floats = line.dtype.kind == "f"
        bad = np.isnan(line) if floats else line >= self._level
        if floats and self._level < np.inf:
            bad |= line >= self._level
        return bad if bad.any() else None

    def _taken_in(self, block: _Block, unknown: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Where an unknown number is taken in, (channel, sample)."""
        buffer = np.zeros((block.rows, self._shape[1]), np.uint8)
        buffer[block.place] = unknown
        taken = np.empty(block.offset.shape, np.uint8)
        _sum(self._taps(buffer, block), [part.takes for part in block.parts], block, taken)
        return taken > 0

    def _taps(self, buffer: NDArray[Any], block: _Block) -> list[NDArray[Any]]:
        """What each part of a block takes in, (tap, channel, sample) views of the buffer."""
        down, right = buffer.strides
        return [
            as_strided(
                buffer[part.first - block.start :, part.samples],
                part.weight.shape,
                (down, self._step * down, right),
                writeable=False,
            )
            for part in block.parts
        ]


def _sum(taps: list[NDArray[Any]], weights: list[NDArray[Any]], block: _Block, out: NDArray[Any]) -> None:
    for part, taken, weight in zip(block.parts, taps, weights, strict=True):
        np.einsum("kcs,kcs->cs", taken, weight, out=out[:, part.samples])


def _fill(buffer: NDArray[np.float32], block: _Block, rows: NDArray[Any], unknown: NDArray[np.bool_] | None) -> None:
    there = buffer[block.place]
    np.copyto(there, rows)
    if unknown is not None and rows.dtype.kind == "f":
        there[unknown] = 0  # nan times no weight would be nan


def _step(banded: Banded) -> int:
    """Bands from one channel's sum to the next, about."""
    return max(1, round(float(np.median(np.diff(banded.first, axis=0))))) if len(banded.first) > 1 else 1


def _cut(banded: Banded) -> Iterator[slice]:
    """Channels of each block."""
    at_once = max(1, _BLOCK_ROWS // _step(banded))
    channels = len(banded.first)
    yield from (slice(start, min(start + at_once, channels)) for start in range(0, channels, at_once))


def _block(channels: slice, bands: int, step: int, parts: Sequence[_Part], offset: NDArray[np.float32]) -> _Block:
    start = min(part.first for part in parts)
    stop = max(part.first + len(part.weight) for part in parts) + step * (channels.stop - channels.start - 1)
    source = slice(*np.clip((start, stop), 0, bands).tolist())
    there = slice(source.start - start, source.stop - start)
    return _Block(channels, start, stop - start, source, there, tuple(parts), np.ascontiguousarray(offset[channels]))


def _parts(banded: Banded, channels: slice, step: int, first_sample: int) -> Iterator[_Part]:
    ahead: NDArray[np.intp] = step * np.arange(channels.stop - channels.start, dtype=np.intp)[:, None]
    begins, takes = banded.first[channels] - ahead, banded.takes[:, channels]
    place: NDArray[np.intp] = begins + np.arange(len(takes), dtype=np.intp)[:, None, None]
    low, high = place.min(axis=(0, 1), where=takes, initial=_FAR), place.max(axis=(0, 1), where=takes, initial=-_FAR)
    nothing = low > high
    low[nothing] = high[nothing] = begins[0, nothing]
    for run in runs(low, high):
        yield _part(banded, channels, begins, first_sample, run)


def runs(low: NDArray[np.intp], high: NDArray[np.intp]) -> Iterator[tuple[slice, int, int]]:
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


def _part(
    banded: Banded, channels: slice, begins: NDArray[np.intp], first_sample: int, run: tuple[slice, int, int]
) -> _Part:
    """Weights of a run of samples, moved to where its window begins."""
    samples, begin, end = run
    shape = (end + 1 - begin, len(begins), samples.stop - samples.start)
    weight, takes = np.zeros(shape, np.float32), np.zeros(shape, np.uint8)
    for tap in range(len(banded.takes)):
        taken = np.nonzero(banded.takes[tap, channels, samples])
        at = (begins[:, samples] + tap - begin)[taken]
        weight[at, *taken] = banded.weight[tap, channels, samples][taken]
        takes[at, *taken] = 1
    return _Part(slice(first_sample + samples.start, first_sample + samples.stop), begin, weight, takes)
