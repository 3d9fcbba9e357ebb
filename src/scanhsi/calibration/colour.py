"""Colour of a reflectance spectrum: CIE 1931 colour-matching functions, illuminant D65, sRGB.

A spectrum sampled at the bands of a cube becomes XYZ by one (bands, 3) matrix::

    XYZ = k * integral of R(l) S(l) [x(l), y(l), z(l)] dl,      k = 1 / integral of S(l) y(l) dl          (CIE 015:2018, eq 7.1)

with S of D65, so that a perfect white has Y = 1 and is sRGB white. R is linear between bands and constant beyond the first and the
last one. Wavelengths outside 380 to 780 nm do not count: nobody sees them.
"""

from __future__ import annotations

from functools import cache
from importlib.resources import files
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

VISIBLE_NM: Final = (380.0, 780.0)

# IEC 61966-2-1:1999, XYZ (D65, Y = 1) to linear sRGB.
_XYZ_TO_RGB: Final = np.array(
    [
        [3.2406, -1.5372, -0.4986],
        [-0.9689, 1.8758, 0.0415],
        [0.0557, -0.2040, 1.0570],
    ]
)
_GRID_NM: Final = 0.25


@cache
def _tables() -> NDArray[np.float64]:
    """Columns wavelength_nm, x_bar, y_bar, z_bar, d65."""
    with files("scanhsi.calibration").joinpath("data/cie1931.csv").open() as file:
        return np.loadtxt(file, delimiter=",", skiprows=4)


def xyz_matrix(wavelength_nm: ArrayLike) -> NDArray[np.float64]:
    """Weights of the bands in X, Y and Z: multiply reflectances by them from the right.

    Args:
        wavelength_nm: (bands,) centres, in any order.

    Returns:
        (bands, 3), float64. A reflectance of 1 in every band gives the white of D65, Y = 1.

    Raises:
        ValueError: Fewer than two bands, or none of them visible.
    """
    wavelength = np.asarray(wavelength_nm, np.float64)
    order = np.argsort(wavelength, kind="stable")
    bands = wavelength[order]
    if bands.size < 2 or not np.any((bands >= VISIBLE_NM[0]) & (bands <= VISIBLE_NM[1])):
        raise ValueError("colour needs at least two bands, and one between 380 and 780 nm")
    table = _tables()
    grid = np.arange(VISIBLE_NM[0], VISIBLE_NM[1] + _GRID_NM / 2, _GRID_NM)
    observer = np.stack([np.interp(grid, table[:, 0], table[:, column] * table[:, 4]) for column in (1, 2, 3)], axis=1)
    observer /= observer[:, 1].sum()
    right = np.clip(np.searchsorted(bands, grid), 1, bands.size - 1)
    left = right - 1
    share = (grid - bands[left]) / np.maximum(bands[right] - bands[left], 1e-9)
    share = np.clip(share, 0.0, 1.0)[:, None]
    matrix = np.zeros((bands.size, 3))
    np.add.at(matrix, order[left], (1 - share) * observer)
    np.add.at(matrix, order[right], share * observer)
    return matrix


def srgb_matrix(wavelength_nm: ArrayLike) -> NDArray[np.float64]:
    """Weights of the bands in linear sRGB: as `xyz_matrix`, but a reflectance of 1 in every band gives (1, 1, 1)."""
    return xyz_matrix(wavelength_nm) @ _XYZ_TO_RGB.T


def xyz_to_srgb(xyz: ArrayLike) -> NDArray[np.float64]:
    """sRGB, 0 to 1, of XYZ under D65 with white at Y = 1. Colours outside the gamut are clipped channel by channel.

    Args:
        xyz: (..., 3).

    Returns:
        (..., 3), gamma-encoded (IEC 61966-2-1).
    """
    linear = np.clip(np.asarray(xyz, np.float64) @ _XYZ_TO_RGB.T, 0.0, 1.0)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def reflectance_to_srgb(reflectance: ArrayLike, wavelength_nm: ArrayLike) -> NDArray[np.float64]:
    """sRGB of spectra.

    Args:
        reflectance: (..., bands), 0 to 1.
        wavelength_nm: (bands,).
    """
    return xyz_to_srgb(np.asarray(reflectance, np.float64) @ xyz_matrix(wavelength_nm))
