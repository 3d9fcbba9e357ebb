"""Views of small cubes whose colours are known."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
import pytest
import xarray as xr

from scanhsi import clock
from scanhsi.calibration.colour import xyz_to_srgb as srgb_of
from scanhsi.calibration.figures.view import save_view
from scanhsi.calibration.view import view
from scanhsi.cube.layout import CubeSpec
from scanhsi.cube.reader import open_cube
from scanhsi.devices.errors import CalibrationError, CubeError, NotACube
from support.colours import adapted, checkers, delta_e, expected_xyz, srgb_to_xyz, white_xyz
from support.cubes import write_cube

WAVELENGTH = np.linspace(371, 950, 218)
PATCH = 12


def dataset(reflectance: np.ndarray, wavelength: np.ndarray | None = WAVELENGTH, **attributes: Any) -> xr.Dataset:
    """A cube of reflectances (bands, lines, samples) under a lamp whose bands differ tenfold, over a dark level."""
    bands, lines, _ = reflectance.shape
    lamp = np.geomspace(300, 3000, bands)[:, None, None]
    counts = np.rint(100 + reflectance * lamp).astype(np.uint16)
    coordinates: dict[str, Any] = {
        "status": ("line", np.ones(lines, np.uint8)),
        "mirror_angle_rad": ("line", np.linspace(-0.01, 0.01, lines)),
    }
    if wavelength is not None:
        coordinates["wavelength"] = ("band", wavelength)
    return xr.Dataset({"cube": (("band", "line", "sample"), counts)}, coordinates, attributes)


def chart(wavelength: np.ndarray = WAVELENGTH) -> tuple[np.ndarray, list[Any]]:
    """Reflectances of a ColorChecker, a row of patches, with a white and a black row; and the spectra of the patches."""
    spectra = checkers()
    row = np.stack([np.interp(wavelength, spectrum.wavelengths, spectrum.values) for spectrum in spectra], axis=1)
    rows = np.stack([np.ones_like(row), row, np.zeros_like(row)], axis=1)
    return np.repeat(np.repeat(rows, PATCH, axis=1), PATCH, axis=2), spectra


@pytest.mark.parametrize(
    "wavelength", [WAVELENGTH, WAVELENGTH[::-1], np.linspace(371, 950, 1088), np.linspace(390, 950, 57)]
)
def test_colours_of_a_chart_between_white_and_black(wavelength: np.ndarray) -> None:
    reflectance, spectra = chart(wavelength)
    look = view(dataset(reflectance, wavelength))
    assert look.true_colour
    seen = look.colour[PATCH : 2 * PATCH].reshape(PATCH, 24, PATCH, 3).mean(axis=(0, 2))
    for rgb, spectrum in zip(seen, spectra, strict=True):
        expected = srgb_of(expected_xyz(spectrum))
        assert delta_e(srgb_to_xyz(rgb), srgb_to_xyz(expected)) < 1.0, spectrum.name


def test_known_white_region() -> None:
    """Something brighter than white must not turn it grey, when it is said where white is."""
    reflectance, _ = chart()
    reflectance[:, :, :40] *= 1.5
    cube = dataset(reflectance)
    assert view(cube).colour[5, 100].max() < 0.9
    look = view(cube, white=(slice(0, PATCH), slice(60, None)))
    assert "white as given" in look.colour_note
    np.testing.assert_allclose(look.colour[5, 100], 1, atol=0.01)
    with pytest.raises(CubeError, match="white region"):
        view(cube, white=(slice(500, 510), slice(0, 3)))


def test_missing_lines_are_no_part_of_it() -> None:
    reflectance, _ = chart()
    cube, whole = dataset(reflectance), view(dataset(reflectance))
    cube["status"][[3, 4, 20]] = 2
    cube["cube"][:, [3, 4, 20]] = 4095  # would be the white, if it counted
    look = view(cube)
    assert list(np.flatnonzero(look.missing)) == [3, 4, 20]
    assert np.isnan(look.colour[[3, 4, 20]]).all()
    assert np.isnan(look.band[20]).all()
    kept = ~look.missing
    np.testing.assert_allclose(look.colour[kept], whole.colour[kept], atol=0.01)


@pytest.mark.parametrize(("wavelength", "name"), [(None, "band 163 of 218"), (np.linspace(790, 990, 218), "803 nm")])
def test_without_visible_wavelengths_colours_are_said_to_be_false(wavelength: np.ndarray | None, name: str) -> None:
    reflectance, _ = chart()
    look = view(dataset(reflectance, wavelength))
    assert not look.true_colour
    assert "false colour" in look.colour_note
    assert look.band_name == name
    np.testing.assert_allclose(look.colour[5], 1, atol=0.01)


def test_band_picture_is_the_band_that_was_asked_for() -> None:
    reflectance, _ = chart()
    cube = dataset(reflectance)
    near = np.abs(WAVELENGTH - 600).argmin()
    np.testing.assert_array_equal(view(cube, band_nm=600).band, cube["cube"].values[near].astype(np.float32))
    assert view(cube, band_nm=1200).band_name == "950 nm (nearest to 1200 nm)"


@pytest.mark.parametrize("shape", [(3, 2300, 4), (3, 17, 2048), (2, 1001, 1), (1, 2, 2)])
def test_big_cubes_are_binned(shape: tuple[int, int, int]) -> None:
    rng = np.random.default_rng(0)
    cube = dataset(rng.uniform(0, 1, shape), None)
    look = view(cube)
    factors = tuple(math.ceil(length / 1000) for length in shape[1:])
    rows, columns = (-(-length // factor) for length, factor in zip(shape[1:], factors, strict=True))
    assert look.band.shape == (rows, columns) == look.colour.shape[:2]
    band = cube["cube"].values[shape[0] * 3 // 4]
    for row, column in ((0, 0), (rows - 1, columns - 1), (rows // 2, columns // 2)):
        part = band[row * factors[0] : (row + 1) * factors[0], column * factors[1] : (column + 1) * factors[1]]
        np.testing.assert_allclose(look.band[row, column], part.mean(), rtol=1e-5)


@pytest.mark.parametrize("simulated", [True, False])
def test_png(tmp_path: Path, simulated: bool) -> None:
    reflectance, _ = chart()
    geometry = {"geometry": {"distance_m": 0.35, "sample_pitch_m": 155e-6}}
    cube = dataset(reflectance, simulated=simulated, instrument=geometry if simulated else {})
    cube["status"][20:24] = 2
    look = view(cube)
    save_view(look, tmp_path / "a.png", title="chart.zarr")
    picture = matplotlib.image.imread(tmp_path / "a.png")
    assert picture.shape[1] == 1460
    foot = picture[-40:].reshape(-1, 4)
    assert (np.ptp(foot[:, :3], axis=1) > 0.3).any() == simulated  # a simulated cube is said to be one, in red
    assert (look.extent_mm is None) != simulated
    if look.extent_mm is not None:
        np.testing.assert_allclose(look.extent_mm, (-22.32, 22.32, -7.0009, 7.0009), rtol=1e-4)
    with pytest.raises(CalibrationError, match="cannot write"):
        save_view(look, tmp_path / "no/a.png", title="")


def test_cubes_on_disk(tmp_path: Path) -> None:
    spec = CubeSpec(40, 6, 7, "uint16", 12, {"simulated": True}, np.linspace(400, 900, 6))
    path = tmp_path / "a.zarr"
    clock.run(write_cube(path, spec, reach=33, missing={4: "lost"}, lines_per_shard=4), virtual=True)
    look = view(path)
    assert look.provenance.simulated
    assert look.lines_planned == 40
    assert look.band.shape == (33, 7)
    np.testing.assert_array_equal(look.band[5], open_cube(path)["cube"].values[4, 5])
    save_view(look, tmp_path / "a.png", title="a.zarr")
    with pytest.raises(NotACube):
        view(tmp_path)
    clock.run(write_cube(tmp_path / "empty.zarr", spec, reach=0), virtual=True)
    with pytest.raises(CubeError, match="holds no line"):
        view(tmp_path / "empty.zarr")


def reflectance_cube(values: np.ndarray, **coordinates: Any) -> xr.Dataset:
    cube = dataset(np.nan_to_num(values))
    cube["cube"] = (("band", "line", "sample"), values.astype(np.float32), {"long_name": "reflectance"})
    return cube.assign_coords(coordinates)


def test_reflectance_has_its_own_colours_under_any_light() -> None:
    values, spectra = chart()
    values[:, 3] = np.nan  # a line that was stored, and holds no number
    values[40, 14, 5] = np.nan  # a hot pixel
    look = view(reflectance_cube(0.5 * values), spectra=50, light="A")
    assert look.colour_note == "CIE 1931, A; of the reflectance"
    assert np.isnan(look.colour[3]).all()
    assert np.isfinite(np.delete(look.colour, 3, axis=0)).all()
    assert look.spectra is not None
    assert 3 not in look.spectra.lines
    white = adapted(0.5 * white_xyz("A"), "A")
    assert delta_e(srgb_to_xyz(look.colour[0, 0]), white) < 0.1
    grey = spectra[21]
    seen = srgb_to_xyz(look.colour[PATCH : 2 * PATCH, 21 * PATCH : 22 * PATCH].mean(axis=(0, 1)))
    assert delta_e(seen, adapted(0.5 * expected_xyz(grey, "A"), "A")) < 0.1
    assert view(reflectance_cube(values)).out_of_gamut == pytest.approx(1 / 72, rel=0.05)  # cyan


def test_ratio_regions_and_places_of_a_rectified_cube(tmp_path: Path) -> None:
    values, _ = chart()
    x, y = np.linspace(-7, 7, values.shape[2]), np.linspace(8, -8, values.shape[1])
    cube = reflectance_cube(values, x=("sample", x), y=("line", y))
    look = view(
        cube, band_nm=800, ratio_nm=600, spectra=5, regions=[(slice(0, 5), slice(0, 9)), (slice(14, 15), slice(7, 8))]
    )
    assert look.band_name == "801 nm / 600 nm"
    assert look.band_quantity == "ratio"
    near = [int(np.abs(WAVELENGTH - nm).argmin()) for nm in (800, 600)]
    np.testing.assert_allclose(look.band[14], values[near[0], 14] / values[near[1], 14], rtol=1e-6)
    assert np.isnan(look.band[-1]).all()  # black over black
    low, high = look.band_range
    assert low < 1 < high  # white is in it
    half = 7 / (values.shape[2] - 1)
    assert look.extent_mm is not None
    np.testing.assert_allclose(look.extent_mm[:2], (-7 - half, 7 + half))
    assert look.extent_mm[3] > 8 > -8 > look.extent_mm[2]
    assert [int(region.count[0]) for region in look.regions] == [45, 1]
    np.testing.assert_allclose(look.regions[1].mean, values[:, 14, 7], rtol=1e-6)
    assert save_view(look, tmp_path / "a.pdf", title="a.zarr").read_bytes().startswith(b"%PDF")
    with pytest.raises(CubeError, match="no wavelengths"):
        view(dataset(values, None), ratio_nm=600)


def test_part_of_the_visible_spectrum_gives_no_true_colours() -> None:
    values, _ = chart(np.linspace(600, 950, 218))
    assert not view(dataset(values, np.linspace(600, 950, 218))).true_colour
