"""The sensor: photoelectrons to digital numbers, with the noise of a CMV2000.

Signal and dark current are Poisson. Above a handful of electrons, and with 13 electrons of read noise on top, a normal of the
same variance cannot be told from it, so all noise of a pixel is one normal number of variance (signal + dark + read^2).
Drawing a million of those a frame would take longer than the exposure: they come from one bank, drawn once, of which each frame
takes a stretch that begins anywhere. Each frame's noise is white, and independent of other frames at the same pixel.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanhsi_sim.effects import SensorOptions
from scanhsi_sim.scenes.base import Image

_DEFAULTS = SensorOptions()
FULL_WELL_E = _DEFAULTS.full_well_e
READ_NOISE_E = _DEFAULTS.read_noise_e
OFFSET_E = _DEFAULTS.offset_e
_DARK_AT_C = 25.0
_DOUBLES_EVERY_K = 7.0
DARK_E_PER_S = _DEFAULTS.dark_e_per_s
PRNU = _DEFAULTS.prnu

_BANK = 1 << 22
_ROWS = 32  # a block of these rows stays in the cache through all the operations on it
_SMALL_PRODUCT = 1 << 18  # multiplications up to which OpenBLAS uses one thread

Floats = NDArray[np.floating[Any]]


class Sensor:
    """One sensor with its fixed pattern; deterministic for a seed and a frame's number.

    Attributes:
        options: What it was made with.
        response: Of each pixel, 1 on average, (band, sample).
        dark_e_per_s: Dark current, hot pixels included, (band, sample).
        offset_e: Black level, (band, sample).
        hot: Hot pixels, (band, sample) bool.
        nonlinear: Those whose dark signal levels off, (band, sample) bool.
    """

    def __init__(self, shape: tuple[int, int], seed: int, options: SensorOptions = _DEFAULTS) -> None:
        """Args: shape, (bands, samples); seed, of the fixed pattern and the noise; options, of the chip."""
        rng = np.random.Generator(np.random.Philox(key=seed))
        self.options = options
        self._seed = seed
        self.response = (1 + np.float32(options.prnu) * rng.standard_normal(shape, np.float32)).astype(np.float32)
        spread = np.float32(options.dark_spread)
        self.dark_e_per_s = np.float32(options.dark_e_per_s) * np.exp(
            spread * rng.standard_normal(shape, np.float32) - spread**2 / 2
        )
        self.hot, self.nonlinear = _hot(shape, rng, options)
        low, high = np.log(np.maximum(options.hot_e_per_s, 1e-9))
        self.dark_e_per_s[self.hot] = np.exp(rng.uniform(low, high, int(self.hot.sum())))
        self.dark_e_per_s *= np.float32(2 ** ((options.temperature_c - _DARK_AT_C) / _DOUBLES_EVERY_K))
        self.offset_e = (options.offset_e + options.dsnu_e * rng.standard_normal(shape)).astype(np.float32)
        self._last_dark: tuple[object, Floats] = None, self.offset_e
        self._bank = rng.standard_normal(max(_BANK, 2 * shape[0] * shape[1]), np.float32)

    def counts_per_electron(self, gain_db: float, bits: int) -> float:
        """Gain K of the whole system."""
        full = self.options.full_scale_e or self.options.full_well_e
        return ((1 << bits) - 1) / full * 10 ** (gain_db / 20)

    def dark_e(self, exposure_s: float, here: tuple[slice, slice] = (slice(None), slice(None))) -> Floats:
        """Mean dark electrons without the offset, before the full well cuts them, (band, sample)."""
        dark = self.dark_e_per_s[here] * np.float32(exposure_s)
        bent = self.nonlinear[here]
        if bent.any():
            tau = self.options.hot_nonlinear_s
            dark[bent] *= np.float32(tau / exposure_s * -math.expm1(-exposure_s / tau))
        return dark

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
        acquisition: int = 0,
    ) -> Image:
        """One frame of the light ``columns @ weights``.

        Args:
            columns: (bands, K) electrons per second.
            weights: (K, samples).
            exposure_s: Exposure time.
            gain_db: Gain; at 0 dB `SensorOptions.full_scale_e` electrons are full scale.
            offset: (band, sample) of the first pixel.
            bits: 8 or 12.
            index: Frame number.
            acquisition: Seeds the noise with the index and the exposure.

        Returns:
            (bands, samples), uint8 for 8 bits, else uint16.
        """
        bands, samples = columns.shape[0], weights.shape[1]
        top = (1 << bits) - 1
        frame = np.empty((bands, samples), np.uint8 if bits == 8 else np.uint16)
        scale = np.float32(self.counts_per_electron(gain_db, bits))
        light = weights * np.float32(exposure_s)
        key = (index, acquisition, round(exposure_s * 1e9))
        noise = self._noise(key, bands * samples).reshape(bands, samples)
        here = (slice(offset[0], offset[0] + bands), slice(offset[1], offset[1] + samples))
        response, black, dark = self.response[here], self.offset_e[here], self._dark(exposure_s, here)
        for first in range(0, bands, _ROWS):
            rows = slice(first, first + _ROWS)
            electrons = _product(columns[rows], light)
            electrons *= response[rows]
            electrons += dark[rows]
            self._add_noise(electrons, noise[rows])
            electrons += black[rows]
            electrons *= scale
            electrons += np.float32(0.5)
            frame[rows] = np.clip(electrons, 0, top, out=electrons)
        return frame

    def _dark(self, exposure_s: float, here: tuple[slice, slice]) -> Floats:
        """`dark_e`, kept from one frame to the next: a scan asks for the same one at each line."""
        key, dark = self._last_dark
        if key != (exposure_s, here):
            dark = self.dark_e(exposure_s, here)
            self._last_dark = (exposure_s, here), dark  # at once: other threads see both or neither
        return dark

    def _add_noise(self, electrons: Floats, noise: Floats) -> None:
        """Shot and read noise, and the full well. A full pixel has no shot noise any more, only that of reading."""
        well, read = np.float32(self.options.full_well_e), np.float32(self.options.read_noise_e)
        np.maximum(electrons, 0, out=electrons)
        brightest = float(electrons.max(initial=0))
        deviation = electrons + read**2 if self.options.shot_noise else np.full_like(electrons, read**2)
        np.sqrt(deviation, out=deviation)
        deviation *= noise
        electrons += deviation
        if brightest > well - 6 * math.sqrt(well):
            np.minimum(electrons, well + read * noise, out=electrons)

    def _noise(self, key: tuple[int, int, int], pixels: int) -> Floats:
        rng = np.random.Generator(np.random.Philox(key=self._seed, counter=np.array([0, *key], np.uint64)))
        start = int(rng.integers(0, self._bank.size - pixels + 1))
        return self._bank[start : start + pixels]


@lru_cache(maxsize=2)
def sensor_of(shape: tuple[int, int], seed: int, options: SensorOptions) -> Sensor:
    """The sensor with this seed: scenes that the same camera looks at share it."""
    return Sensor(shape, seed, options)


def _hot(
    shape: tuple[int, int], rng: np.random.Generator, options: SensorOptions
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Maps of hot pixels, and of those that are not linear: so many, to the pixel."""
    size = shape[0] * shape[1]
    places = rng.choice(size, round(options.hot_per_million * size / 1e6), replace=False, shuffle=True)
    hot, nonlinear = np.zeros(size, bool), np.zeros(size, bool)
    hot[places] = True
    nonlinear[places[: round(options.hot_nonlinear * len(places))]] = True
    return hot.reshape(shape), nonlinear.reshape(shape)


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
