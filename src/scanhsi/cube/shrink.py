"""One pass over a cube that makes small pictures of it: some sums over its bands, each averaged over a few lines and samples."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scanhsi.cube.spectra import stored

Floats = NDArray[np.float32]

_BLOCK_BYTES: Final = 32_000_000
_CACHE_BYTES: Final = 4_000_000
_BRIDGED: Final = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Means:
    """Means over groups of neighbouring bands.

    Attributes:
        edges: First band of each group, and the end of the last one.
    """

    edges: NDArray[np.intp]

    @classmethod
    def of(cls, bands: slice) -> Means:
        """Mean of some bands."""
        return cls(np.array([bands.start, bands.stop], np.intp))

    @property
    def bands(self) -> slice:
        """What is read."""
        return slice(int(self.edges[0]), int(self.edges[-1]))

    @property
    def planes(self) -> int:
        """How many pictures come out."""
        return len(self.edges) - 1

    def __call__(self, values: NDArray[Any]) -> NDArray[Any]:
        """(band, line, sample) to (plane, line, sample)."""
        sums = np.float64 if values.dtype.kind == "f" else np.uint32
        own = self.edges - self.edges[0]
        return np.stack([values[low:high].sum(axis=0, dtype=sums) / (high - low) for low, high in pairwise(own)])


@dataclass(frozen=True, slots=True, eq=False)
class Weighted:
    """Weighted sums over bands.

    A band that is nan, a hot pixel's say, is taken to be as its neighbour, while such bands weigh less than a twentieth of all.

    Attributes:
        bands: What is read.
        weights: (plane, band) float32.
    """

    bands: slice
    weights: Floats

    @property
    def planes(self) -> int:
        """How many pictures come out."""
        return len(self.weights)

    def __call__(self, values: NDArray[Any]) -> NDArray[Any]:
        """(band, line, sample) to (plane, line, sample)."""
        bands, lines, samples = values.shape
        at_once = max(1, _CACHE_BYTES // (4 * bands * samples))
        out = np.empty((self.planes, lines, samples), np.float32)
        for first in range(0, lines, at_once):
            some = values[:, first : first + at_once].reshape(bands, -1).astype(np.float32)
            if values.dtype.kind == "f":
                self._bridge(some)
            out[:, first : first + at_once] = (self.weights @ some).reshape(self.planes, -1, samples)
        return out

    def _bridge(self, spectra: Floats) -> None:
        """Fill gaps of spectra, (band, pixel), in place."""
        gaps = ~np.isfinite(spectra)
        pixels = np.flatnonzero(gaps.any(axis=0))
        if not pixels.size:
            return
        weight = np.abs(self.weights).sum(axis=0)
        pixels = pixels[weight @ gaps[:, pixels] < _BRIDGED * weight.sum()]
        known = ~gaps[:, pixels]
        bands = np.arange(len(spectra))[:, None]
        below = np.maximum.accumulate(np.where(known, bands, -1), axis=0)
        above = np.minimum.accumulate(np.where(known, bands, len(spectra))[::-1], axis=0)[::-1]
        nearest = np.where((below >= 0) & ((bands - below <= above - bands) | (above == len(spectra))), below, above)
        spectra[:, pixels] = np.take_along_axis(spectra[:, pixels], nearest, axis=0)


Reduce = Means | Weighted


def shrink(dataset: xr.Dataset, wanted: Sequence[Reduce], binning: tuple[int, int]) -> list[Floats]:
    """Pictures of a cube, in memory of some shards.

    Args:
        dataset: Of `scanhsi.open_cube`.
        wanted: What to make of the bands.
        binning: Lines and samples that go into one pixel.

    Returns:
        For each, (plane, row, column) float32; nan where no line is stored, or a pixel that goes in is nan.
    """
    there = stored(dataset)
    rows, columns = -(-len(there) // binning[0]), -(-dataset.sizes["sample"] // binning[1])
    pictures = [np.full((reduce.planes, rows, columns), np.nan, np.float32) for reduce in wanted]
    for block in _blocks(dataset["cube"], binning[0]):
        good = np.flatnonzero(there[block])
        if not good.size:
            continue
        place, starts, counts = np.unique((good + block.start) // binning[0], return_index=True, return_counts=True)
        pixels = dataset["cube"].isel(line=block)
        for picture, reduce in zip(pictures, wanted, strict=True):
            planes = reduce(np.asarray(pixels.isel(band=reduce.bands).values))
            means = _bin_samples(planes[:, good], binning[1])
            picture[:, place] = np.add.reduceat(means, starts, axis=1) / counts[:, None]
    return pictures


def _blocks(cube: xr.DataArray, binning: int) -> Iterator[slice]:
    """Lines to be read together: some shards, and whole rows of the picture."""
    bands, lines, samples = cube.shape
    shard = int((cube.encoding.get("shards") or (bands, 16, samples))[1])
    shards = max(1, _BLOCK_BYTES // (bands * samples * cube.dtype.itemsize * shard))
    size = math.lcm(shard, binning) if binning <= shard else binning
    size *= max(1, shards * shard // size)
    for start in range(0, lines, size):
        yield slice(start, min(start + size, lines))


def _bin_samples(planes: NDArray[Any], size: int) -> NDArray[Any]:
    """Means over so many neighbouring samples."""
    if size == 1:
        return planes
    starts = np.arange(0, planes.shape[2], size, dtype=np.intp)
    return np.add.reduceat(planes, starts, axis=2) / np.diff(np.append(starts, planes.shape[2]))
