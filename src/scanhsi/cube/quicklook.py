"""The on-line colour picture of a cube: array ``quicklook``, an eighth of the size, written shard by shard with the pixels.

Each of its pixels is a weighted sum over the bands of one sample in eight, averaged over eight lines. The weights come from who
knows about colour. Values are linear and in counts of the camera: no white balance, no gamma.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from scanhsi.cube.binning import Binning

SCALE: Final = 8
_LARGEST: Final = np.iinfo(np.uint16).max


@dataclass(frozen=True, slots=True, eq=False)
class QuicklookSpec:
    """What the picture shows.

    Attributes:
        weights: (channels, bands) of the camera's bands; a channel is the weighted sum of counts.
        channels: Their names.
        note: How the weights came about, in one line, for the attributes.
    """

    weights: NDArray[np.float64]
    channels: tuple[str, ...] = ("red", "green", "blue")
    note: str = "weighted sums of raw counts, linear, not white-balanced"


@dataclass(frozen=True, slots=True)
class QuicklookScale:
    """Lines and samples (as stored) of one pixel of the picture; whole shards make whole pixels."""

    lines: int
    samples: int

    @classmethod
    def choose(cls, lines_per_shard: int, binning: Binning) -> QuicklookScale:
        """Eight lines, or what divides a shard; eight of the camera's samples."""
        lines = next(lines for lines in range(SCALE, 0, -1) if lines_per_shard % lines == 0)
        return cls(lines, max(1, SCALE // binning.samples))

    def shape(self, lines: int, samples: int) -> tuple[int, int]:
        """(rows, columns) of a picture of so many lines and samples."""
        return math.ceil(lines / self.lines), math.ceil(samples / self.samples)


class QuicklookMaker:
    """Makes the picture of one shard after another.

    Args:
        spec: What it shows.
        binning: Of what is stored.
        scale: Of the picture.
    """

    def __init__(self, spec: QuicklookSpec, binning: Binning, scale: QuicklookScale) -> None:
        self._scale = scale
        bands = spec.weights.shape[1] // binning.bands
        grouped = spec.weights[:, : bands * binning.bands].reshape(len(spec.weights), bands, binning.bands)
        # a stored pixel is a sum: the mean weight of its bands, and the mean of its samples
        self._weights = (grouped.mean(axis=2) / binning.samples).astype(np.float32)

    def picture(self, lines: NDArray[Any], lost: NDArray[np.bool_]) -> NDArray[np.uint16]:
        """(channel, row, column) of (line, band, sample) as stored; zero where every line is lost."""
        scale = self._scale
        rows, columns = scale.shape(len(lines), lines.shape[2])
        picture = np.zeros((len(self._weights), rows, columns), np.uint16)
        total = np.empty((lines.shape[1], columns), np.float32)
        for row in range(rows):
            there = [
                line for line in range(row * scale.lines, min((row + 1) * scale.lines, len(lines))) if not lost[line]
            ]
            if not there:
                continue
            total.fill(0)
            for line in there:
                total += lines[line, :, :: scale.samples]
            picture[:, row] = np.clip(np.rint(self._weights @ total / len(there)), 0, _LARGEST)
        return picture
