"""From reflectance to photoelectrons: lamp, lens and grating, quantum efficiency, line spread, smile and keystone."""

from __future__ import annotations

import math
from functools import cache
from importlib.resources import files
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, optimize
from scipy.interpolate import CubicSpline
from scipy.special import ndtr

from scanhsi_sim.effects import LampOptions, OpticsOptions, Setup
from scanhsi_sim.filters import blur

Floats = NDArray[np.floating[Any]]
Spectrum = NDArray[np.float64]

BANDS_PER_CHANNEL = 5
FWHM = 2 * math.sqrt(2 * math.log(2))
"""Full width at half maximum of a Gaussian over its standard deviation."""

_DEFAULTS = OpticsOptions()
_SMILE_NODES = np.array([0.0, 0.5, 1.0])


def wavelength_nm(bands: int, dispersion: tuple[float, ...] = _DEFAULTS.wavelength_nm) -> Spectrum:
    """Wavelengths of the raw bands of the sensor, lambda(p) = 370.79 + 2.68 p - 1e-4 p^2 (paper, section 3.3).

    p counts channels of five raw bands: 371 to 950 nm over 1088 bands.
    """
    channel = np.arange(bands) / BANDS_PER_CHANNEL
    return np.asarray(np.polynomial.polynomial.polyval(channel, np.array(dispersion)), np.float64)


def wavelengths(setup: Setup) -> Spectrum:
    """Wavelengths of the bands of an instrument, (bands,), in the middle of the slit."""
    return wavelength_nm(setup.geometry.sensor[0], setup.optics.wavelength_nm)


@cache
def table(name: str) -> Spectrum:
    """A data table of the package, one row a wavelength, the wavelength in nm in its first column."""
    with (files("scanhsi_sim") / "data" / name).open() as file:
        return np.loadtxt(file, delimiter=",", skiprows=1)


def efficiency(wavelength: Spectrum) -> Spectrum:
    """Photoelectrons a photon: lens, grating and the sensor's quantum efficiency, (bands,)."""
    glass = 1 / (1 + np.exp(-(wavelength - 385) / 8))  # lenses end in the near ultraviolet
    grating = 0.35 + 0.65 * np.exp(-(((wavelength - 600) / 220) ** 2))  # blazed in the middle of its range
    quantum = table("cmv2000_qe.csv")
    return glass * grating * np.interp(wavelength, quantum[:, 0], quantum[:, 1])


def electron_rates(wavelength: Spectrum, lamp: LampOptions | None = None) -> Spectrum:
    """Photoelectrons per second and pixel for a white tile, shape (bands,).

    Photons of a halogen lamp (Planck) times lens and grating times the sensor's quantum efficiency.
    """
    lamp = lamp or LampOptions()
    metres = wavelength * 1e-9
    photons = metres**-4 / np.expm1(1.438777e-2 / (metres * lamp.temperature_k))
    rates = photons * efficiency(wavelength)
    return rates * (lamp.white_e_per_s / rates.max())


@cache
def _slit(sigma: float) -> float:
    """Width of the box that, blurred by a Gaussian of this standard deviation, becomes a line of full width 1."""

    def half(box: float) -> float:
        return float(_blurred(0.5, box, sigma)) - 0.5

    return float(cast("Any", optimize.brentq(half, 1e-3, 1.0)))


def _blurred(place: Any, box: float, sigma: float) -> Any:
    edges = ndtr((place + box / 2) / sigma) - ndtr((place - box / 2) / sigma)
    return edges / (2 * ndtr(box / 2 / sigma) - 1)


def line_shape(place: Spectrum, sigma: float | None = None) -> Spectrum:
    """A line of height 1 and full width 1 at half maximum: the image of the slit, a box, blurred by lens and pixel, a Gaussian."""
    if sigma is None:
        return np.exp(-((place * FWHM) ** 2) / 2)
    return np.asarray(_blurred(place, _slit(sigma), sigma), np.float64)


def spread_lines(
    spectra: Spectrum, wavelength: Spectrum, fwhm_nm: float = _DEFAULTS.lsf_fwhm_nm, sigma: float | None = None
) -> Spectrum:
    """Spectra (bands, K) as the slit smears them."""
    fwhm = fwhm_nm / float(np.mean(np.diff(wavelength)))
    if sigma is None:
        return np.asarray(blur(spectra, (fwhm / FWHM, 0), reach=5.0), np.float64)
    reach = math.ceil(2.5 * fwhm)
    kernel = line_shape(np.arange(-reach, reach + 1) / fwhm, sigma)
    return cast("Spectrum", ndimage.convolve1d(spectra, kernel / kernel.sum(), axis=0, mode="nearest"))


def reflected(reflectances: Spectrum, setup: Setup) -> Spectrum:
    """Electron rates (bands, K) of surfaces in the light of the halogen lamp, smeared by the slit."""
    wavelength = wavelengths(setup)
    light = electron_rates(wavelength, setup.lamp)[:, None]
    return spread_lines(reflectances * light, wavelength, setup.optics.lsf_fwhm_nm, setup.optics.lsf_blur)


class Spectrograph:
    """Images a line of mixed spectra onto the sensor, with smile, keystone and vignetting.

    A line is a sum over K spectra, each with its weight along the slit, so a frame is one small matrix product
    (bands, 5 K) @ (5 K, samples). Smile moves a spectrum by ``s(x) = smile x^2`` bands, x from -1 to 1 along the slit: spectra are
    moved by splines at three values of s, and between these interpolated (Lagrange), within 1e-3 of a line's peak. Keystone
    moves a weight by ``u(band) keystone x`` samples, u from -1 to 1 over the bands: a Taylor series of second order.
    """

    def __init__(self, rates: Spectrum, samples: int, options: OpticsOptions = _DEFAULTS) -> None:
        """Args: rates, electrons per second (bands, K), smeared by the slit; samples, those of the whole sensor."""
        bands = len(rates)
        self._options = options
        spline = CubicSpline(np.arange(bands), rates) if bands > 1 else None
        moved = [
            spline(np.clip(np.arange(bands) - node * options.smile_px, 0, bands - 1)) if spline else rates
            for node in _SMILE_NODES
        ]
        skew = np.linspace(-1, 1, bands)[:, None]
        columns = np.stack([*moved, rates * skew, rates * skew**2], axis=1)
        self._columns = columns.astype(np.float32)  # (bands, 5, K)
        self._across = np.linspace(-1, 1, samples, dtype=np.float32)

    def columns(self, band: int, bands: int, which: NDArray[np.intp]) -> Floats:
        """Electron rates of a range of bands, of the spectra that are seen, (bands, 5 K)."""
        part = self._columns[band : band + bands]
        if len(which) < part.shape[2]:
            part = part[:, :, which]
        return part.reshape(len(part), -1)

    def weights(self, abundance: Floats, sample: int) -> Floats:
        """Weights (5 K, samples) for `columns` from abundances (K, samples), whose first sample is `sample`."""
        across = self._across[sample : sample + abundance.shape[1]]
        lit = abundance * (1 - np.float32(self._options.vignetting) * across**2)
        bent = [lit * weight for weight in _lagrange(across**2)]
        slope, bend = _derivatives(lit)
        move = np.float32(self._options.keystone_px) * across
        return np.concatenate([*bent, -slope * move, bend * (move**2 / 2)]).astype(np.float32)


def _lagrange(place: Floats) -> list[Floats]:
    """Weights of the values at the smile's nodes, to interpolate at places between 0 and 1."""
    weights: list[Floats] = []
    for node in _SMILE_NODES:
        others = [other for other in _SMILE_NODES if other != node]
        weights.append(np.prod([(place - other) / (node - other) for other in others], axis=0))
    return weights


def _derivatives(values: Floats) -> tuple[Floats, Floats]:
    """First and second, along the samples."""
    if values.shape[1] < 3:
        return np.zeros_like(values), np.zeros_like(values)
    padded = np.pad(values, ((0, 0), (1, 1)), mode="edge")
    before, after = padded[:, :-2], padded[:, 2:]
    return (after - before) / 2, after - 2 * values + before
