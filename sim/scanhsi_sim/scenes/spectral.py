"""Scenes made of spectra: every point is a mixture of a few reflectances, seen through the spectrograph by the sensor."""

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from scanhsi_sim.optics import Spectrograph
from scanhsi_sim.scenes.base import Geometry, Image
from scanhsi_sim.sensor import Sensor

Floats = NDArray[np.floating[Any]]


class Maps(Protocol):
    """Where how much of each spectrum is."""

    def line(self, step: int, sample: int, samples: int) -> Floats:
        """Abundances (K, samples) that the slit sees at a mirror step, from a first sample on."""
        ...


class SpectralScene:
    """Maps of abundance x spectra, rendered through optics and sensor."""

    def __init__(self, geometry: Geometry, spectra: NDArray[np.float64], maps: Maps, seed: int) -> None:
        """Args: spectra, reflectances (bands, K) on the whole sensor; maps, their abundances; seed, of the noise."""
        self._spectrograph = Spectrograph(spectra, geometry.sensor[1])
        self._sensor = Sensor(geometry.sensor, seed)
        self._maps = maps

    def render(
        self,
        step_start: int,
        step_end: int,
        *,
        exposure_s: float,
        gain_db: float,
        shape: tuple[int, int],
        offset: tuple[int, int],
        bits: int,
        index: int,
    ) -> Image:
        """One frame; a moving mirror blurs it by the mean over the steps it passed."""
        bands, samples = shape
        steps = range(step_start, step_end + 1)
        abundance = sum((self._maps.line(step, offset[1], samples) for step in steps), np.float32(0)) / np.float32(
            len(steps)
        )
        return self._sensor.expose(
            self._spectrograph.columns(offset[0], bands),
            self._spectrograph.weights(np.asarray(abundance, np.float32), offset[1]),
            exposure_s=exposure_s,
            gain_db=gain_db,
            offset=offset,
            bits=bits,
            index=index,
        )


class _Everywhere:
    """One spectrum, all over."""

    def line(self, step: int, sample: int, samples: int) -> Floats:
        """Full abundance."""
        del step, sample
        return np.ones((1, samples), np.float32)


def _flat(geometry: Geometry, seed: int, reflectance: float) -> SpectralScene:
    spectra = np.full((geometry.sensor[0], 1), reflectance)
    return SpectralScene(geometry, spectra, _Everywhere(), seed)


def white_scene(geometry: Geometry, seed: int) -> SpectralScene:
    """A white tile of 99 % reflectance, for white references."""
    return _flat(geometry, seed, 0.99)


def dark_scene(geometry: Geometry, seed: int) -> SpectralScene:
    """A closed shutter, for dark references."""
    return _flat(geometry, seed, 0.0)
