"""From reflectance to photoelectrons: lamp, lens and grating, quantum efficiency, line spread, smile and keystone."""

from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanhsi_sim.filters import blur

Floats = NDArray[np.floating[Any]]

BANDS_PER_CHANNEL = 5
LSF_FWHM_NM = 2.9
LAMP_K = 3200.0
WHITE_PEAK_E_PER_S = 160e3
"""Photoelectrons per second of a white tile in its brightest band: 60 % of the full well in 50 ms."""

_SMILE_PX = 0.8
_KEYSTONE_PX = 0.6
_VIGNETTING = 0.12


def wavelength_nm(bands: int) -> NDArray[np.float64]:
    """Wavelengths of the raw bands of the sensor, lambda(p) = 370.79 + 2.68 p - 1e-4 p^2 (paper, section 3.3).

    p counts channels of five raw bands: 371 to 950 nm over 1088 bands.
    """
    p = np.arange(bands) / BANDS_PER_CHANNEL
    return 370.79 + 2.68 * p - 1e-4 * p**2


@cache
def table(name: str) -> NDArray[np.float64]:
    """A data table of the package, one row a wavelength, the wavelength in nm in its first column."""
    with (files("scanhsi_sim") / "data" / name).open() as file:
        return np.loadtxt(file, delimiter=",", skiprows=1)


def electron_rates(wavelength: NDArray[np.float64]) -> NDArray[np.float64]:
    """Photoelectrons per second and pixel for a white tile, shape (bands,).

    Photons of a halogen lamp (Planck, 3200 K) times lens and grating times the sensor's quantum efficiency.
    """
    metres = wavelength * 1e-9
    photons = metres**-4 / np.expm1(1.438777e-2 / (metres * LAMP_K))
    glass = 1 / (1 + np.exp(-(wavelength - 385) / 8))  # lenses end in the near ultraviolet
    grating = 0.35 + 0.65 * np.exp(-(((wavelength - 600) / 220) ** 2))  # blazed in the middle of its range
    efficiency = table("cmv2000_qe.csv")
    rates = photons * glass * grating * np.interp(wavelength, efficiency[:, 0], efficiency[:, 1])
    return rates * (WHITE_PEAK_E_PER_S / rates.max())


def spread_lines(spectra: NDArray[np.float64], wavelength: NDArray[np.float64]) -> NDArray[np.float64]:
    """Spectra (bands, K) as the slit smears them: a Gaussian line spread function of 2.9 nm FWHM."""
    nm_per_band = float(np.mean(np.diff(wavelength)))
    return np.asarray(blur(spectra, (LSF_FWHM_NM / 2.3548 / nm_per_band, 0)), np.float64)


class Spectrograph:
    """Images a line of mixed spectra onto the sensor, with smile, keystone and vignetting.

    A line is a sum over K spectra, each with its weight along the slit, so a frame is one small matrix product
    (bands, K) @ (K, samples). Smile moves a spectrum by s(x) bands and keystone a weight by u(band) w(x) samples; both are
    below a pixel, so their Taylor series (second order in s, first order in u w) only make K larger.
    """

    def __init__(self, spectra: NDArray[np.float64], samples: int) -> None:
        """Args: spectra, reflectances (bands, K) at `wavelength_nm`; samples, those of the whole sensor."""
        bands = len(spectra)
        wavelength = wavelength_nm(bands)
        rates = spread_lines(spectra * electron_rates(wavelength)[:, None], wavelength)
        slope = np.gradient(rates, axis=0)
        skew = np.linspace(-_KEYSTONE_PX, _KEYSTONE_PX, bands)[:, None]
        columns = [rates, slope, np.gradient(slope, axis=0) / 2, rates * skew]
        self._columns = np.concatenate(columns, axis=1).astype(np.float32)
        self._across = np.linspace(-1, 1, samples, dtype=np.float32)

    def columns(self, band: int, bands: int) -> Floats:
        """Electron rates of a range of bands, (bands, 4 K)."""
        return self._columns[band : band + bands]

    def weights(self, abundance: Floats, sample: int) -> Floats:
        """Weights (4 K, samples) for `columns` from abundances (K, samples), whose first sample is `sample`."""
        across = self._across[sample : sample + abundance.shape[1]]
        smile = _SMILE_PX * across**2
        lit = abundance * (1 - _VIGNETTING * across**2)
        stretched = np.gradient(lit, axis=1) * across if lit.shape[1] > 1 else np.zeros_like(lit)
        return np.concatenate([lit, lit * smile, lit * smile**2, stretched]).astype(np.float32)
