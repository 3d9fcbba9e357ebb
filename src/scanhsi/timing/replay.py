"""Recorded delays, replayed: blocks of whole line records, so that bursts stay bursts and what came together stays together.

A stationary bootstrap (Politis and Romano, *J. Am. Stat. Assoc.* 89, 1303, 1994): from a line drawn at random on, the recorded
lines follow each other, until with probability 1 / `block_lines` a line the next block begins. Blocks end where their scan ends
(they wrap round to its begin), and all streams of a line come from the same recorded line, whichever device spends them: which
one depends on the seed and the line number only.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from scanhsi.timing.delays import DelayProfile, DelayStreams, RecordedScan, Stream, uniforms

Ns = NDArray[np.int64]

BLOCK_LINES: Final = 50
"""Mean length of a block, in lines."""
_NONE: Final = -1


def delay_streams(profile: DelayProfile, seed: int, block_lines: int = BLOCK_LINES) -> DelayStreams:
    """The delays of every line: replayed where the profile was recorded, else drawn from its distributions.

    Args:
        profile: Of the instrument.
        seed: Of the draws. Devices of one instrument need the same, or what came together comes apart.
        block_lines: Mean length of a replayed block; 1 replays each line by itself; 0 draws each delay by itself, from its
            distribution.
    """
    return ReplayedStreams(profile, seed, block_lines) if profile.scans and block_lines else DelayStreams(profile, seed)


@dataclass(frozen=True)
class _Pool:
    """Recorded lines to draw from, one scan behind the other."""

    scans: tuple[RecordedScan, ...]

    @cached_property
    def first(self) -> Ns:
        """Number of the first line of each scan, and of all lines at the end."""
        return np.cumsum([0, *(scan.lines for scan in self.scans)], dtype=np.int64)

    def rows(self, u: NDArray[np.float64], block_lines: int) -> Ns:
        """Recorded line of each line, from uniforms of shape `(lines, 2)`."""
        line = np.arange(len(u))
        begin = np.maximum.accumulate(np.where(u[:, 0] < 1 / block_lines, line, 0))
        row = (u[begin, 1] * self.first[-1]).astype(np.int64)
        scan = (self.first[:-1] <= row[:, None]).sum(1) - 1
        start, lines = self.first[scan], np.diff(self.first)[scan]
        return start + (row - start + line - begin) % lines

    def column(self, stream: Stream, per_step_ns: int) -> Ns:
        """Delay of each recorded line without what its steps took, `_NONE` in scans that have no such delay at all."""
        return np.concatenate([_filled(scan, stream, per_step_ns) for scan in self.scans])


class ReplayedStreams(DelayStreams):
    """Delays as they were recorded, in blocks of lines. What was not recorded is drawn from its distribution."""

    def __init__(self, profile: DelayProfile, seed: int, block_lines: int = BLOCK_LINES) -> None:
        if block_lines < 1:
            raise ValueError(f"block_lines must be at least 1, not {block_lines}")
        super().__init__(profile, seed)
        self._block_lines = block_lines
        self._pools: dict[str | None, _Pool] = {}
        self._columns: dict[tuple[Stream, str | None], Ns] = {}

    def _draw(self, stream: Stream, pixel_format: str | None, number: int) -> Ns:
        pool = self._pool(pixel_format)
        column = self._column(pool, stream, pixel_format)
        if bool(np.all(column == _NONE)):
            return super()._draw(stream, pixel_format, number)
        drawn = column[pool.rows(uniforms(self.seed, "rows", number, 2), self._block_lines)]
        absent = drawn == _NONE
        return np.where(absent, super()._draw(stream, pixel_format, number), drawn) if absent.any() else drawn

    def _pool(self, pixel_format: str | None) -> _Pool:
        """Scans in this pixel format; all, where none is asked for."""
        if pixel_format not in self._pools:
            chosen = [scan for scan in self.profile.scans if pixel_format in (None, scan.pixel_format)]
            self._pools[pixel_format] = _Pool(tuple(chosen))
        return self._pools[pixel_format]

    def _column(self, pool: _Pool, stream: Stream, pixel_format: str | None) -> Ns:
        key = stream, pixel_format
        if key not in self._columns:
            empty = np.empty(0, np.int64)
            per_step_ns = round(self.profile.per_step_s(stream) * 1e9)
            self._columns[key] = pool.column(stream, per_step_ns) if pool.scans else empty
        return self._columns[key]


def _filled(scan: RecordedScan, stream: Stream, per_step_ns: int) -> Ns:
    """One scan's delays; a line without one has that of the line before it that has (at the begin, the next one's)."""
    values = scan.delays_ns.get(stream)
    column = np.array([_NONE if value is None else value for value in values or (_NONE,) * scan.lines], np.int64)
    present = np.flatnonzero(column != _NONE)
    if not len(present):
        return column
    nearest = np.searchsorted(present, np.arange(scan.lines), "right") - 1
    return np.maximum(column[present[np.maximum(nearest, 0)]] - per_step_ns * scan.steps, 0)
