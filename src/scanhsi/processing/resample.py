"""Moving lines by a fraction of a pixel, along one axis, differently at each pixel.

The value at a place between pixels is that of the cubic through the four nearest (Lagrange), or of the straight line through two:
weights of neighbours, worked out once. A pixel that is not known spoils what takes it in with a weight, and nothing else.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from scanhsi.processing.banded import Banded

Floats = NDArray[np.float64]
Axis = Literal["band", "sample"]
Kind = Literal["cubic", "linear"]

_NEGLIGIBLE: Final = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class _Tap:
    """One neighbour: its distance, the part of the frame where it counts, and its weight there."""

    offset: int
    bands: slice
    samples: slice
    weight: NDArray[np.float32]


class Mover:
    """Moves lines; made once, used on any number of lines and from any thread."""

    def __init__(self, shift: Floats, axis: Axis, *, kind: Kind = "cubic", conserve: bool = False) -> None:
        """Keep what the weights are worked out from, when they are needed.

        Args:
            shift: (band, sample): a pixel of the result is taken from so many pixels further on along the axis.
            axis: Along which.
            kind: Of interpolation.
            conserve: Keep the sum along the axis (counts) instead of the values (reflectances).
        """
        self._along = 0 if axis == "band" else 1
        self._shift, self._kind, self._conserve = shift, kind, conserve

    @functools.cached_property
    def _outside(self) -> NDArray[np.bool_]:
        return self._places(self._shift)[2]

    @functools.cached_property
    def _taps(self) -> list[_Tap]:
        base, weights, _ = self._places(self._shift)
        return list(_taps(base - self._own(base), weights))

    def _own(self, frame: NDArray[Any]) -> NDArray[np.intp]:
        own = np.arange(frame.shape[self._along], dtype=np.intp)
        return own[None, :] if self._along else own[:, None]

    def _places(self, shift: Floats) -> tuple[NDArray[np.intp], list[Floats], NDArray[np.bool_]]:
        """Where each pixel is taken from: pixel before, weights of the four around, and whether that is beyond the sensor."""
        size = shift.shape[self._along]
        place = shift + self._own(shift)
        inside = (place >= -_NEGLIGIBLE) & (place <= size - 1 + _NEGLIGIBLE)
        base = np.clip(np.floor(place), 0, size - 2).astype(np.intp)
        share = np.clip(place - base, 0, 1)
        share[share < _NEGLIGIBLE] = 0
        scale = 1 + np.gradient(shift, axis=self._along) if self._conserve else np.ones_like(shift)
        edge = (base == 0) | (base == size - 2) if self._kind == "cubic" else np.ones(base.shape, bool)
        return base, [weight * np.where(inside, scale, 0.0) for weight in _weights(share, edge)], ~inside

    def banded(self, bands: int, samples: slice) -> Banded | None:
        """As a sum along the bands; None if it moves along the samples."""
        if self._along:
            return None
        base, weights, outside = self._places(self._shift[:, samples])
        weight = np.stack(weights)
        return Banded(bands, base - 1, weight, weight != 0, np.where(outside, np.nan, 0.0))

    def __call__(self, lines: NDArray[np.floating[Any]]) -> NDArray[np.float32]:
        """Move some lines, (band, line, sample); nan where a neighbour is not known, and beyond the sensor."""
        unknown = np.isnan(lines)
        bad = np.nonzero(unknown) if unknown.any() else None
        if bad is not None:
            lines = np.where(unknown, np.float32(0), lines)
        out = np.zeros(lines.shape, np.float32)
        for tap in self._taps:
            out[tap.bands, :, tap.samples] += tap.weight[:, None, :] * lines[self._source(tap)]
        if bad is not None:
            self._spoil(out, *bad)
        out[np.broadcast_to(self._outside[:, None, :], out.shape)] = np.nan
        return out

    def _source(self, tap: _Tap) -> tuple[slice, slice, slice]:
        parts = [tap.bands, tap.samples]
        moved = parts[self._along]
        parts[self._along] = slice(moved.start + tap.offset, moved.stop + tap.offset)
        return parts[0], slice(None), parts[1]

    def _spoil(
        self, out: NDArray[np.float32], band: NDArray[np.intp], line: NDArray[np.intp], sample: NDArray[np.intp]
    ) -> None:
        for tap in self._taps:
            there = [band, sample]
            there[self._along] = there[self._along] - tap.offset
            row, column = there[0] - tap.bands.start, there[1] - tap.samples.start
            rows, columns = tap.weight.shape
            hit = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
            hit[hit] = tap.weight[row[hit], column[hit]] != 0
            out[there[0][hit], line[hit], there[1][hit]] = np.nan


def _taps(whole: NDArray[np.intp], weights: Sequence[Floats]) -> Iterator[_Tap]:
    """The neighbours, each cut to the runs of samples where it counts, so that little is multiplied by nothing."""
    for offset in range(int(whole.min()) - 1, int(whole.max()) + 3):
        weight = np.zeros(whole.shape)
        for index, value in enumerate(weights):
            here = whole + index - 1 == offset
            weight[here] = value[here]
        used = (weight != 0).any(axis=0)
        for first, last in _runs(used):
            rows = np.flatnonzero((weight[:, first:last] != 0).any(axis=1))
            bands = slice(int(rows[0]), int(rows[-1]) + 1)
            part = np.ascontiguousarray(weight[bands, first:last], np.float32)
            yield _Tap(offset, bands, slice(first, last), part)


def _weights(share: Floats, edge: NDArray[np.bool_]) -> tuple[Floats, Floats, Floats, Floats]:
    """Of the neighbours at -1, 0, 1 and 2; at an edge, where one is missing, of two."""
    t = share
    cubic = (
        -t * (t - 1) * (t - 2) / 6,
        (t + 1) * (t - 1) * (t - 2) / 2,
        -(t + 1) * t * (t - 2) / 2,
        (t + 1) * t * (t - 1) / 6,
    )
    straight = (np.zeros_like(t), 1 - t, t, np.zeros_like(t))
    return tuple(np.where(edge, two, four) for two, four in zip(straight, cubic, strict=True))  # pyright: ignore[reportReturnType]


def _runs(used: NDArray[np.bool_]) -> Iterator[tuple[int, int]]:
    steps = np.diff(np.concatenate(([False], used, [False])).astype(np.int8))
    yield from zip(np.flatnonzero(steps == 1).tolist(), np.flatnonzero(steps == -1).tolist(), strict=True)
