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


def expected_xyz(spectrum: Any) -> NDArray[np.float64]:
    """XYZ of a reflectance under D65, white at Y = 1, by summation over 1 nm."""
    cmfs = colour.MSDS_CMFS[_OBSERVER].copy().trim(colour.SpectralShape(380, 780, 1))
    light = colour.SDS_ILLUMINANTS["D65"].copy().align(cmfs.shape)
    xyz = colour.sd_to_XYZ(spectrum.copy().align(cmfs.shape), cmfs, light, method="Integration")
    return np.asarray(xyz, np.float64) / 100


def xyz_to_srgb(xyz: NDArray[np.float64]) -> NDArray[np.float64]:
    """sRGB, clipped to the gamut."""
    return np.clip(np.asarray(colour.XYZ_to_sRGB(xyz), np.float64), 0, 1)


def srgb_to_xyz(rgb: NDArray[np.float64]) -> NDArray[np.float64]:
    """The way back."""
    return np.asarray(colour.sRGB_to_XYZ(rgb), np.float64)


def delta_e(one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    """CIEDE2000 difference of two XYZ."""
    white = colour.CCS_ILLUMINANTS[_OBSERVER]["D65"]
    return float(colour.delta_E(colour.XYZ_to_Lab(one, white), colour.XYZ_to_Lab(other, white), method="CIE 2000"))
