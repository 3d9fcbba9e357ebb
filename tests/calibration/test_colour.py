"""Colours against an independent implementation, over the bands of the paper's instrument."""

from __future__ import annotations

import numpy as np
import pytest

from scanhsi.calibration.colour import reflectance_to_srgb, xyz_matrix, xyz_to_srgb
from support import colours
from support.colours import checkers, delta_e, expected_xyz

CHANNELS = np.linspace(370.79, 950.28, 218)
ROWS = np.linspace(371.2, 949.6, 1088)


@pytest.mark.parametrize("wavelength", [CHANNELS, ROWS, CHANNELS[::-1]], ids=["channels", "rows", "reversed"])
def test_colour_checker(wavelength: np.ndarray) -> None:
    differences = []
    for spectrum in checkers():
        reflectance = np.interp(wavelength, spectrum.wavelengths, spectrum.values)
        differences.append(delta_e(reflectance @ xyz_matrix(wavelength), expected_xyz(spectrum)))
    assert len(differences) == 24
    assert max(differences) < 0.2


def test_srgb_against_colour() -> None:
    for spectrum in checkers():
        xyz = expected_xyz(spectrum)
        np.testing.assert_allclose(xyz_to_srgb(xyz), colours.xyz_to_srgb(xyz), atol=2e-3)


def test_white_grey_and_black_have_no_hue() -> None:
    spectra = np.array([0.0, 0.001, 0.18, 0.5, 1.0])[:, None] * np.ones(CHANNELS.size)
    rgb = reflectance_to_srgb(spectra, CHANNELS)
    assert np.ptp(rgb, axis=1).max() < 0.002
    np.testing.assert_allclose(rgb.mean(axis=1), [0, 0.0129, 0.4614, 0.7354, 1.0], atol=2e-3)


def test_infrared_does_not_count() -> None:
    spectrum = np.full(CHANNELS.size, 0.3)
    changed = np.where(CHANNELS > 785, 1.0, spectrum)
    np.testing.assert_array_equal(reflectance_to_srgb(spectrum, CHANNELS), reflectance_to_srgb(changed, CHANNELS))


def test_out_of_gamut_is_clipped() -> None:
    rgb = reflectance_to_srgb(np.abs(CHANNELS - 520) < 5, CHANNELS)
    assert rgb.min() == 0
    assert rgb.max() <= 1


@pytest.mark.parametrize("wavelength", [[550.0], [800.0, 900.0]])
def test_no_colour_without_visible_bands(wavelength: list[float]) -> None:
    with pytest.raises(ValueError, match="380 and 780"):
        xyz_matrix(wavelength)
