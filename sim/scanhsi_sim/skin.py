"""Reflectance spectra of skin: haemoglobin, melanin and water in a scattering tissue.

Absorption and scattering after S. L. Jacques, "Optical properties of biological tissues: a review", Phys. Med. Biol. 58 (2013) R37;
reflectance by diffusion theory (Cuccia et al. 2009, at spatial frequency 0). Wavelengths in nm, coefficients per mm.
"""

import numpy as np
from numpy.typing import NDArray

from scanhsi_sim.optics import table

Spectrum = NDArray[np.float64]

BLOOD_PER_MM = 2.303 * 150 / 64_500 / 10
"""Molar extinction to absorption per mm of whole blood, with 150 g/l of haemoglobin of 64,500 g/mol."""
REFRACTIVE_INDEX = 1.4
EPIDERMIS_MM = 0.06


def blood_absorption(wavelength: Spectrum, saturation: float) -> Spectrum:
    """Absorption of whole blood at an oxygen saturation from 0 to 1."""
    data = table("absorbers.csv")
    molar = saturation * data[:, 1] + (1 - saturation) * data[:, 2]
    return BLOOD_PER_MM * np.interp(wavelength, data[:, 0], molar)


def scattering(wavelength: Spectrum) -> Spectrum:
    """Reduced scattering of the dermis."""
    return 4.6 * (wavelength / 500) ** -1.421


def dermis_absorption(wavelength: Spectrum, blood: float, saturation: float, water: float = 0.65) -> Spectrum:
    """Absorption of the dermis with these volume fractions of blood and water."""
    data = table("absorbers.csv")
    base = (0.244 + 85.3 * np.exp(-(wavelength - 154) / 66.2)) / 10
    in_water = np.interp(wavelength, data[:, 0], data[:, 3]) / 10
    return blood * blood_absorption(wavelength, saturation) + water * in_water + base


def diffuse_reflectance(absorption: Spectrum, scatter: Spectrum) -> Spectrum:
    """Share of the light that comes back from a thick tissue."""
    n = REFRACTIVE_INDEX
    inside = 0.0636 * n + 0.668 + 0.710 / n - 1.440 / n**2
    boundary = (1 - inside) / (2 * (1 + inside))
    total = absorption + scatter
    decay = np.sqrt(3 * absorption / total)
    return 3 * boundary * (scatter / total) / ((decay + 1) * (decay + 3 * boundary))


def skin(wavelength: Spectrum, *, blood: float = 0.02, melanin: float = 0.03, saturation: float = 0.8) -> Spectrum:
    """Reflectance of skin with these volume fractions of blood (dermis) and melanosomes (epidermis)."""
    melanosome = 6.6e10 * wavelength**-3.33 / 10
    epidermis = np.exp(-2 * melanin * melanosome * EPIDERMIS_MM)
    return epidermis * diffuse_reflectance(dermis_absorption(wavelength, blood, saturation), scattering(wavelength))


def over_vein(
    wavelength: Spectrum, surface: Spectrum, *, depth_mm: float = 0.9, path_mm: float = 2.6, saturation: float = 0.6
) -> Spectrum:
    """Reflectance of `surface` above a vein.

    Of the light that returns, a share exp(-2 mu_eff depth) has been as deep as the vein and has crossed `path_mm` of its blood.
    Blue light does not get there and red light is hardly absorbed; so veins show best in the near infrared.
    """
    tissue = dermis_absorption(wavelength, 0.015, 0.8)
    effective = np.sqrt(3 * tissue * (tissue + scattering(wavelength)))
    reached = np.exp(-2 * effective * depth_mm)
    return surface * (1 - reached * (1 - np.exp(-path_mm * blood_absorption(wavelength, saturation))))
