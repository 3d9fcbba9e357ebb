"""Moving lines by a fraction of a pixel, along one axis, differently at each pixel.

The value at a place between pixels is that of the cubic through the four nearest (Lagrange), or of the straight line through two:
weights of neighbours, worked out once. A pixel that is not known spoils what takes it in with a weight, and nothing else.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from scanhsi.processing.banded import Banded
from scanhsi.processing.kernel import Kernel
from scanhsi.processing.slit import Neighbours, SlitKernel

Floats = NDArray[np.float64]
Axis = Literal["band", "sample"]
Kind = Literal["cubic", "linear"]

_NEGLIGIBLE: Final = 1e-6


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
    def _kernel(self) -> Callable[[NDArray[np.floating[Any]]], NDArray[np.float32]]:
        bands, samples = self._shift.shape
        if self._along:
            return SlitKernel(bands, self._neighbours)
        whole = self.banded(bands, slice(0, samples))
        assert whole is not None, "it moves along the bands"
        return Kernel([(slice(0, samples), whole)])

    def _neighbours(self, bands: slice) -> Neighbours:
        base, weights, outside = self._places(self._shift[bands])
        return base - 1, np.stack(weights), outside

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
        return self._kernel(lines)


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
