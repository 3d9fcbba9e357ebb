"""Colours of known spectra by an independent implementation, the package colour-science."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # optional parts of the package that are not installed here
    import colour

_OBSERVER = "CIE 1931 2 Degree Standard Observer"


def checkers() -> list[Any]:
    """The 24 patches of a ColorChecker, as spectral distributions."""
    return list(colour.SDS_COLOURCHECKERS["ColorChecker N Ohta"].values())


def spectrum(name: str, wavelength_nm: NDArray[np.float64], values: NDArray[np.float64]) -> Any:
    """A spectral distribution."""
    return colour.SpectralDistribution(dict(zip(wavelength_nm.tolist(), values.tolist(), strict=True)), name=name)


def expected_xyz(spectrum: Any, light: str = "D65") -> NDArray[np.float64]:
    """XYZ of a reflectance under a light, white at Y = 1, by summation over 1 nm."""
    cmfs = colour.MSDS_CMFS[_OBSERVER].copy().trim(colour.SpectralShape(380, 780, 1))
    power = colour.SDS_ILLUMINANTS[light].copy().align(cmfs.shape)
    xyz = colour.sd_to_XYZ(spectrum.copy().align(cmfs.shape), cmfs, power, method="Integration")
    return np.asarray(xyz, np.float64) / 100


def white_xyz(light: str) -> NDArray[np.float64]:
    """XYZ of a perfect white under a light."""
    return expected_xyz(colour.sd_ones(colour.SpectralShape(380, 780, 1)), light)


def adapted(xyz: NDArray[np.float64], light: str) -> NDArray[np.float64]:
    """XYZ under D65 that looks the same (Bradford)."""
    matrix = colour.adaptation.matrix_chromatic_adaptation_VonKries(
        white_xyz(light), white_xyz("D65"), transform="Bradford"
    )
    return np.asarray(matrix, np.float64) @ xyz


def xyz_to_srgb(xyz: NDArray[np.float64]) -> NDArray[np.float64]:
    """sRGB, clipped to the gamut."""
    return np.clip(np.asarray(colour.XYZ_to_sRGB(xyz), np.float64), 0, 1)


def srgb_to_xyz(rgb: NDArray[np.float64]) -> NDArray[np.float64]:
    """The way back."""
    return np.asarray(colour.sRGB_to_XYZ(rgb), np.float64)


def lab(xyz: NDArray[np.float64], light: str = "D65") -> NDArray[np.float64]:
    """CIE L*a*b* beside the white of a light."""
    return np.asarray(colour.XYZ_to_Lab(xyz, colour.XYZ_to_xy(white_xyz(light))), np.float64)


def delta_e(one: NDArray[np.float64], other: NDArray[np.float64], light: str = "D65") -> float:
    """CIEDE2000 difference of two XYZ."""
    return float(colour.delta_E(lab(one, light), lab(other, light), method="CIE 2000"))
