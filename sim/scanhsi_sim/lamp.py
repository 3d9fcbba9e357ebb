"""The lamps: how bright they are over time, and the lines of the spectral lamp."""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray

from scanhsi_sim.effects import Setup
from scanhsi_sim.optics import efficiency, line_shape, wavelengths

_FLICKER = 1  # a stream of random numbers of its own


def settled(setup: Setup, time_s: float) -> float:
    """Brightness without flicker over that of the settled lamp, a time after the camera connected: 1 + A exp(-t / tau) + drift."""
    lamp = setup.lamp
    on_s = lamp.on_before_s + time_s
    return 1 + lamp.warm_up * math.exp(-on_s / lamp.warm_up_s) + lamp.drift_per_min * on_s / 60


def brightness(setup: Setup, time_s: float, index: int, acquisition: int) -> float:
    """Brightness at a time, with the flicker of this frame."""
    level = settled(setup, time_s)
    if setup.lamp.flicker:
        counter = np.array([0, index, acquisition, 0], np.uint64)
        rng = np.random.Generator(np.random.Philox(key=np.array([setup.seed, _FLICKER], np.uint64), counter=counter))
        level *= 1 + setup.lamp.flicker * rng.standard_normal()
    return max(level, 0.0)


@dataclass(frozen=True, slots=True)
class SpectralLine:
    """A line of the spectral lamp.

    Attributes:
        element: Hg or Ar.
        wavelength_nm: In air.
        intensity: Relative, on a scale of its own for each element.
    """

    element: str
    wavelength_nm: float
    intensity: float


@cache
def hgar_lines() -> tuple[SpectralLine, ...]:
    """The lines of the mercury-argon lamp, from ``data/hgar_lines.csv``."""
    with (files("scanhsi_sim") / "data" / "hgar_lines.csv").open() as file:
        rows = csv.DictReader(line for line in file if not line.startswith("#"))
        return tuple(SpectralLine(row["element"], float(row["air_nm"]), float(row["intensity"])) for row in rows)


def hgar_rates(setup: Setup) -> NDArray[np.float64]:
    """Electrons per second of the spectral lamp, (bands,): lines of the shape of the slit's image, point-sampled."""
    wavelength = wavelengths(setup)
    band = np.arange(len(wavelength))
    fwhm = setup.optics.lsf_fwhm_nm / float(np.mean(np.diff(wavelength)))
    rates = np.zeros(len(wavelength))
    for element, brightest in (("Hg", setup.lamp.hg_e_per_s), ("Ar", setup.lamp.ar_e_per_s)):
        lines = [line for line in hgar_lines() if line.element == element]
        where = np.array([line.wavelength_nm for line in lines])
        strength = np.array([line.intensity for line in lines]) * efficiency(where)
        inside = (where > wavelength[0] - 10) & (where < wavelength[-1] + 10)
        if not inside.any():
            continue
        strength *= brightest / strength[inside].max()
        centre = np.interp(where[inside], wavelength, band, left=-1e3, right=1e6)
        rates += line_shape((band[:, None] - centre) / fwhm, setup.optics.lsf_blur) @ strength[inside]
    return rates
