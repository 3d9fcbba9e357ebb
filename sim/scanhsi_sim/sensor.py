"""The sensor: photoelectrons to digital numbers, with the noise of a CMV2000.

Signal and dark current are Poisson. Above a handful of electrons, and with 13 electrons of read noise on top, a normal of the
same variance cannot be told from it, so all noise of a pixel is one normal number of variance (signal + dark + read^2).
Drawing a million of those a frame would take longer than the exposure: they come from one bank, drawn once, of which each frame
takes a stretch that begins anywhere. Each frame's noise is white, and independent of other frames at the same pixel.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanhsi_sim.scenes.base import Image

FULL_WELL_E = 13_500.0
READ_NOISE_E = 13.0
OFFSET_E = 100.0
"""Black level, so that noise around zero is not cut off."""
DARK_E_PER_S = 125.0
PRNU = 0.01

_HOT_SHARE = 2e-5
_BANK = 1 << 22
_ROWS = 32  # a block of these rows stays in the cache through all the operations on it
_SMALL_PRODUCT = 1 << 18  # multiplications up to which OpenBLAS uses one thread

Floats = NDArray[np.floating[Any]]


class Sensor:
    """One sensor with its fixed pattern; deterministic for a seed and a frame index."""

    def __init__(self, shape: tuple[int, int], seed: int) -> None:
        """Args: shape, (bands, samples); seed, of the fixed pattern and the noise."""
        rng = np.random.Generator(np.random.Philox(key=seed))
        self._seed = seed
        self._response = (1 + PRNU * rng.standard_normal(shape, np.float32)).astype(np.float32)
        # Dark current has a log-normal spread; hot pixels are its far tail.
        self._dark = DARK_E_PER_S * np.exp(0.4 * rng.standard_normal(shape, np.float32) - np.float32(0.08))
        hot = rng.random(shape, np.float32) < _HOT_SHARE
        self._dark[hot] *= rng.uniform(100, 2000, int(hot.sum()))
        self._bank = rng.standard_normal(max(_BANK, 2 * shape[0] * shape[1]), np.float32)

    def expose(
        self,
        columns: Floats,
        weights: Floats,
        *,
        exposure_s: float,
        gain_db: float,
        offset: tuple[int, int],
        bits: int,
        index: int,
    ) -> Image:
        """One frame of the light ``columns @ weights``.

        Args:
            columns: (bands, K) electrons per second.
            weights: (K, samples).
            exposure_s: Exposure time.
            gain_db: Gain; at 0 dB the full well is full scale.
            offset: (band, sample) of the first pixel.
            bits: 8 or 12.
            index: Frame number.

        Returns:
            (bands, samples), uint8 for 8 bits, else uint16.
        """
        bands, samples = columns.shape[0], weights.shape[1]
        top = (1 << bits) - 1
        frame = np.empty((bands, samples), np.uint8 if bits == 8 else np.uint16)
        scale = np.float32(top / FULL_WELL_E * 10 ** (gain_db / 20))
        light = weights * np.float32(exposure_s)
        noise = self._noise(index, bands * samples).reshape(bands, samples)
        here = (slice(offset[0], offset[0] + bands), slice(offset[1], offset[1] + samples))
        response, dark = self._response[here], self._dark[here]
        for first in range(0, bands, _ROWS):
            rows = slice(first, first + _ROWS)
            electrons = _product(columns[rows], light)
            electrons *= response[rows]
            electrons += dark[rows] * np.float32(exposure_s)
            np.clip(electrons, 0, FULL_WELL_E, out=electrons)
            deviation = electrons + np.float32(READ_NOISE_E**2)
            np.sqrt(deviation, out=deviation)
            deviation *= noise[rows]
            electrons += deviation
            electrons += np.float32(OFFSET_E)
            electrons *= scale
            electrons += np.float32(0.5)
            frame[rows] = np.clip(electrons, 0, top, out=electrons)
        return frame

    def _noise(self, index: int, pixels: int) -> Floats:
        rng = np.random.Generator(np.random.Philox(key=self._seed, counter=index << 64))
        start = int(rng.integers(0, self._bank.size - pixels + 1))
        return self._bank[start : start + pixels]


def _product(columns: Floats, weights: Floats) -> Floats:
    """``columns @ weights`` in pieces that OpenBLAS computes in the calling thread.

    Its own threads wait for each other by spinning: beside a busy program a product of a millisecond took half a second.
    """
    rows, depth = columns.shape
    width = max(1, _SMALL_PRODUCT // (rows * depth))
    product = np.empty((rows, weights.shape[1]), np.float32)
    for first in range(0, weights.shape[1], width):
        piece = slice(first, first + width)
        np.matmul(columns, weights[:, piece], out=product[:, piece])
    return product
