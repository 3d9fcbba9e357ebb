"""Colours against an independent implementation, over the bands of the paper's instrument."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from scanhsi.calibration.colour import (
    into_gamut,
    out_of_gamut,
    reflectance_to_srgb,
    srgb_matrix,
    xyz_matrix,
    xyz_to_linear,
    xyz_to_srgb,
)
from scanhsi.calibration.illuminants import illuminant
from scanhsi.devices.errors import ConfigError
from support import colours
from support.colours import adapted, checkers, delta_e, expected_xyz, lab, srgb_to_xyz, white_xyz

XYZ_TO_RGB = xyz_to_linear(np.eye(3)).T

CHANNELS = np.linspace(370.79, 950.28, 218)
ROWS = np.linspace(371.2, 949.6, 1088)


@pytest.mark.parametrize("wavelength", [CHANNELS, ROWS, CHANNELS[::-1]], ids=["channels", "rows", "reversed"])
def test_colour_checker(wavelength: np.ndarray) -> None:
    differences = []
    for spectrum in checkers():
        reflectance = np.interp(wavelength, spectrum.wavelengths, spectrum.values)
        differences.append(delta_e(reflectance @ xyz_matrix(wavelength), expected_xyz(spectrum)))
    assert len(differences) == 24
    assert max(differences) < 0.1
    assert np.mean(differences) < 0.04


@pytest.mark.parametrize("light", ["A", "C", "D50", "E", "FL2", "FL11", "LED-B3"])
def test_colour_checker_under_other_lights(light: str) -> None:
    matrix, differences = xyz_matrix(CHANNELS, light), []
    np.testing.assert_allclose(matrix.sum(axis=0), white_xyz(light), rtol=3e-4)
    for spectrum in checkers()[::3]:
        reflectance = np.interp(CHANNELS, spectrum.wavelengths, spectrum.values)
        expected = expected_xyz(spectrum, light)
        differences.append(delta_e(reflectance @ matrix, expected, light))
        looks = np.linalg.solve(XYZ_TO_RGB, reflectance @ srgb_matrix(CHANNELS, light))
        differences.append(delta_e(looks, adapted(expected, light)))
    assert max(differences) < 0.15


def test_srgb_against_colour() -> None:
    beyond = []
    for spectrum in checkers():
        xyz = expected_xyz(spectrum)
        ours, theirs = xyz_to_srgb(xyz), colours.xyz_to_srgb(xyz)
        if out_of_gamut(xyz_to_linear(xyz)):
            beyond.append(spectrum.name)
            shown = srgb_to_xyz(ours)
            assert shown[1] == pytest.approx(xyz[1], rel=1e-3)  # as bright as it is; clipping makes it brighter
            assert abs(srgb_to_xyz(theirs)[1] / xyz[1] - 1) > 0.01
            assert abs(hue_deg(shown) - hue_deg(xyz)) < abs(hue_deg(srgb_to_xyz(theirs)) - hue_deg(xyz))
        else:
            np.testing.assert_allclose(ours, theirs, atol=2e-3)
    assert beyond == ["cyan"]


def hue_deg(xyz: np.ndarray) -> float:
    _, a, b = lab(xyz)
    return float(np.degrees(np.arctan2(b, a)))


def test_lights_by_temperature_and_by_table(tmp_path: Path) -> None:
    glowing, standard = illuminant("2856 K"), illuminant("A")
    np.testing.assert_allclose(100 * glowing.at(standard.wavelength_nm), standard.power, rtol=2e-3)
    table = tmp_path / "lamp.csv"
    table.write_text(
        "nm,power\n" + "\n".join(f"{nm},{p}" for nm, p in zip(standard.wavelength_nm, standard.power, strict=True))
    )
    np.testing.assert_allclose(xyz_matrix(CHANNELS, str(table)), xyz_matrix(CHANNELS, "a"), rtol=1e-12)
    for text in ("nm,power\n400,1\n", "nm,power\n400,1\n500,-1\n", "nothing"):
        table.write_text(text)
        with pytest.raises(ConfigError, match="no table of a light"):
            illuminant(str(table))
    for name in ("candle", "20 K", "no.csv"):
        with pytest.raises(ConfigError):
            illuminant(name)


def test_white_grey_and_black_have_no_hue() -> None:
    spectra = np.array([0.0, 0.001, 0.18, 0.5, 1.0])[:, None] * np.ones(CHANNELS.size)
    rgb = reflectance_to_srgb(spectra, CHANNELS)
    assert np.ptp(rgb, axis=1).max() < 0.002
    np.testing.assert_allclose(rgb.mean(axis=1), [0, 0.0129, 0.4614, 0.7354, 1.0], atol=2e-3)


def test_infrared_does_not_count() -> None:
    spectrum = np.full(CHANNELS.size, 0.3)
    changed = np.where(CHANNELS > 785, 1.0, spectrum)
    np.testing.assert_array_equal(reflectance_to_srgb(spectrum, CHANNELS), reflectance_to_srgb(changed, CHANNELS))


def test_out_of_gamut_is_shown_as_bright_as_it_is() -> None:
    laser = 3.0 * (np.abs(CHANNELS - 520) < 5)
    rgb = reflectance_to_srgb(laser, CHANNELS)
    assert 0 <= rgb.min() <= rgb.max() <= 1
    assert np.argmax(rgb) == 1
    assert srgb_to_xyz(rgb)[1] == pytest.approx((laser @ xyz_matrix(CHANNELS))[1], rel=2e-3)
    np.testing.assert_array_equal(into_gamut(np.array([[5.0, 3.0, 9.0], [0.0, 0.0, -1.0]])), [[1, 1, 1], [0, 0, 0]])


@pytest.mark.parametrize("wavelength", [[550.0], [800.0, 900.0]])
def test_no_colour_without_visible_bands(wavelength: list[float]) -> None:
    with pytest.raises(ValueError, match="380 and 780"):
        xyz_matrix(wavelength)
