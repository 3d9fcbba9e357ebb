"""Scenes made of spectra: every point is a mixture of a few of them, seen through the spectrograph by the sensor."""

from __future__ import annotations

import math
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from scanhsi_sim.effects import Setup
from scanhsi_sim.lamp import brightness
from scanhsi_sim.optics import Spectrograph, reflected
from scanhsi_sim.scenes.base import Image
from scanhsi_sim.sensor import sensor_of

Floats = NDArray[np.floating[Any]]


class Maps(Protocol):
    """Where how much of each spectrum is."""

    def line(self, step: float, sample: int, samples: int) -> Floats:
        """Abundances (K, samples) that the slit sees at a mirror step, from a first sample on."""
        ...


class SpectralScene:
    """Maps of abundance x electron rates, rendered through optics and sensor."""

    def __init__(self, setup: Setup, rates: NDArray[np.float64], maps: Maps) -> None:
        """Args: rates, electrons per second (bands, K) on the whole sensor, smeared by the slit; maps, their abundances."""
        self._spectrograph = Spectrograph(rates, setup.geometry.sensor[1], setup.optics)
        self._sensor = sensor_of(setup.geometry.sensor, setup.seed, setup.sensor)
        self._setup = setup
        self._maps = maps

    def render(
        self,
        step_start: float,
        step_end: float,
        *,
        exposure_s: float,
        gain_db: float,
        shape: tuple[int, int],
        offset: tuple[int, int],
        bits: int,
        index: int,
        acquisition: int = 0,
        time_s: float = 0.0,
    ) -> Image:
        """One frame; a moving mirror blurs it by the mean over the steps it passed."""
        bands, samples = shape
        steps = np.linspace(step_start, step_end, math.ceil(step_end - step_start - 1e-6) + 1).tolist()
        abundance = np.sum([self._maps.line(step, offset[1], samples) for step in steps], axis=0)
        seen = np.flatnonzero(np.any(abundance, axis=1))
        share = np.float32(brightness(self._setup, time_s, index, acquisition) / len(steps))
        return self._sensor.expose(
            self._spectrograph.columns(offset[0], bands, seen),
            self._spectrograph.weights(np.asarray(abundance[seen] * share, np.float32), offset[1]),
            exposure_s=exposure_s,
            gain_db=gain_db,
            offset=offset,
            bits=bits,
            index=index,
            acquisition=acquisition,
        )


class Everywhere:
    """One spectrum, all over."""

    def line(self, step: float, sample: int, samples: int) -> Floats:
        """Full abundance."""
        del step, sample
        return np.ones((1, samples), np.float32)


def even(setup: Setup, rates: NDArray[np.float64]) -> SpectralScene:
    """The same spectrum all over, (bands,) electrons per second."""
    return SpectralScene(setup, rates[:, None], Everywhere())


def tile(setup: Setup, reflectance: float) -> SpectralScene:
    """A tile of the same reflectance at all wavelengths; 0 is a closed shutter."""
    return SpectralScene(setup, reflected(np.full((setup.geometry.sensor[0], 1), reflectance), setup), Everywhere())
