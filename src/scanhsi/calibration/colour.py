"""Colour of a reflectance spectrum: CIE 1931 colour-matching functions, any illuminant, sRGB.

A spectrum sampled at the bands of a cube becomes XYZ by one (bands, 3) matrix::

    XYZ = k * integral of R(l) S(l) [x(l), y(l), z(l)] dl,      k = 1 / integral of S(l) y(l) dl          (CIE 015:2018, eq 7.1)

with S of the illuminant, so that a perfect white has Y = 1. R is linear between bands and constant beyond the first and the last
one. Wavelengths outside 380 to 780 nm do not count: nobody sees them.

sRGB has its own white, D65. Colours under another light are adapted to it (Bradford), so that white paper stays white, as it
does to who stands in that light. Colours that sRGB cannot show are mixed with the grey of their luminance until it can: luminance
and hue stay, saturation goes. Clipping channel by channel, the usual way, turns cyan into blue.
"""

from __future__ import annotations

from functools import cache
from importlib.resources import files
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scanhsi.calibration.illuminants import Illuminant, illuminant

Floats = NDArray[np.float64]

VISIBLE_NM: Final = (380.0, 780.0)

# IEC 61966-2-1:1999, XYZ (D65, Y = 1) to linear sRGB.
_XYZ_TO_RGB: Final = np.array(
    [
        [3.2406, -1.5372, -0.4986],
        [-0.9689, 1.8758, 0.0415],
        [0.0557, -0.2040, 1.0570],
    ]
)
_LUMINANCE: Final = np.linalg.inv(_XYZ_TO_RGB)[1]
# Bradford: XYZ to the cones' responses in which whites are scaled (CIE 159:2004, annex).
_XYZ_TO_CONES: Final = np.array(
    [
        [0.8951, 0.2664, -0.1614],
        [-0.7502, 1.7135, 0.0367],
        [0.0389, -0.0685, 1.0296],
    ]
)
_GRID_NM: Final = 0.25
_SHOWN: Final = 1e-3
"""Beyond the gamut by less than this is rounding."""


@cache
def _observer() -> Floats:
    """Columns wavelength_nm, x_bar, y_bar, z_bar."""
    with files("scanhsi.calibration").joinpath("data/cie1931.csv").open() as file:
        return np.loadtxt(file, delimiter=",", skiprows=4)


def xyz_matrix(wavelength_nm: ArrayLike, light: str | Illuminant = "D65") -> Floats:
    """Weights of the bands in X, Y and Z: multiply reflectances by them from the right.

    Args:
        wavelength_nm: (bands,) centres, in any order.
        light: Illuminant, or its name, see `scanhsi.calibration.illuminants.illuminant`.

    Returns:
        (bands, 3), float64. A reflectance of 1 in every band gives the white of the light, Y = 1: the sum over the bands.

    Raises:
        ValueError: Fewer than two bands, or none of them visible.
        ConfigError: No such light.
    """
    wavelength = np.asarray(wavelength_nm, np.float64)
    order = np.argsort(wavelength, kind="stable")
    bands = wavelength[order]
    if bands.size < 2 or not np.any((bands >= VISIBLE_NM[0]) & (bands <= VISIBLE_NM[1])):
        raise ValueError("colour needs at least two bands, and one between 380 and 780 nm")
    grid, weights = _weights(illuminant(light) if isinstance(light, str) else light)
    right = np.clip(np.searchsorted(bands, grid), 1, bands.size - 1)
    left = right - 1
    share = (grid - bands[left]) / np.maximum(bands[right] - bands[left], 1e-9)
    share = np.clip(share, 0.0, 1.0)[:, None]
    matrix = np.zeros((bands.size, 3))
    np.add.at(matrix, order[left], (1 - share) * weights)
    np.add.at(matrix, order[right], share * weights)
    return matrix


def _weights(light: Illuminant) -> tuple[Floats, Floats]:
    """A fine grid in nm, and observer times light on it, (grid, 3), the sum of y 1."""
    grid: Floats = np.arange(VISIBLE_NM[0], VISIBLE_NM[1] + _GRID_NM / 2, _GRID_NM)
    table = _observer()
    observed: list[Floats] = [np.interp(grid, table[:, 0], table[:, column]) for column in (1, 2, 3)]
    weights = np.stack(observed, axis=1) * light.at(grid)[:, None]
    return grid, weights / weights[:, 1].sum()


@cache
def d65_white() -> Floats:
    """XYZ of white under D65, the white of sRGB."""
    return _weights(illuminant("D65"))[1].sum(axis=0)


def adaptation(white: ArrayLike) -> Floats:
    """Matrix that takes XYZ seen beside a white to XYZ beside the white of D65, (3, 3): multiply it from the left (Bradford)."""
    cones, wanted = _XYZ_TO_CONES @ np.asarray(white, np.float64), _XYZ_TO_CONES @ d65_white()
    return np.linalg.inv(_XYZ_TO_CONES) @ np.diag(wanted / cones) @ _XYZ_TO_CONES


def srgb_matrix(wavelength_nm: ArrayLike, light: str | Illuminant = "D65") -> Floats:
    """Weights of the bands in linear sRGB: as `xyz_matrix`, but a reflectance of 1 in every band gives (1, 1, 1)."""
    matrix = xyz_matrix(wavelength_nm, light)
    return matrix @ (_XYZ_TO_RGB @ adaptation(matrix.sum(axis=0))).T


def xyz_to_srgb(xyz: ArrayLike, white: ArrayLike | None = None) -> Floats:
    """sRGB, 0 to 1, of XYZ with white at Y = 1.

    Args:
        xyz: (..., 3).
        white: XYZ of white in that light; None: that of D65.

    Returns:
        (..., 3), gamma-encoded (IEC 61966-2-1); within the gamut, see `into_gamut`.
    """
    return encode(into_gamut(xyz_to_linear(xyz, white)))


def xyz_to_linear(xyz: ArrayLike, white: ArrayLike | None = None) -> Floats:
    """Linear sRGB of XYZ; as `xyz_to_srgb`, but colours out of the gamut stay where they are, below 0 or above 1."""
    matrix = _XYZ_TO_RGB if white is None else _XYZ_TO_RGB @ adaptation(white)
    return np.asarray(xyz, np.float64) @ matrix.T


def into_gamut(linear: Floats) -> Floats:
    """Linear sRGB that a screen can show: mixed with the grey of the same luminance as far as needed; white beyond white.

    Args:
        linear: (..., 3).
    """
    grey: Floats = np.clip(linear @ _LUMINANCE, 0.0, 1.0)[..., None]
    away = linear - grey
    room: Floats = np.where(away > 0, 1 - grey, grey)
    share = np.min(room / np.maximum(np.abs(away), 1e-12), axis=-1, keepdims=True)
    return np.clip(grey + np.minimum(share, 1.0) * away, 0.0, 1.0)


def out_of_gamut(linear: Floats) -> NDArray[np.bool_]:
    """Whether linear sRGB, (..., 3), lies beyond what sRGB can show."""
    return np.any((linear < -_SHOWN) | (linear > 1 + _SHOWN), axis=-1)


def encode(linear: Floats) -> Floats:
    """Gamma of sRGB (IEC 61966-2-1), of linear values from 0 to 1."""
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def reflectance_to_srgb(reflectance: ArrayLike, wavelength_nm: ArrayLike, light: str | Illuminant = "D65") -> Floats:
    """sRGB of spectra.

    Args:
        reflectance: (..., bands), 0 to 1.
        wavelength_nm: (bands,).
        light: As of `xyz_matrix`.
    """
    return encode(into_gamut(np.asarray(reflectance, np.float64) @ srgb_matrix(wavelength_nm, light)))
