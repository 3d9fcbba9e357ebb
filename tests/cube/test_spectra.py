"""Spectra of pixels and regions, bands and ratios, of cubes with holes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

from scanhsi import clock
from scanhsi.cube import spectra as module
from scanhsi.cube.layout import CubeSpec
from scanhsi.cube.reader import open_cube
from scanhsi.cube.shrink import Means, Weighted, shrink
from scanhsi.cube.spectra import (
    band_picture,
    band_ratio,
    bands_near,
    random_spectra,
    ratio_of,
    region_spectrum,
    spectrum_at,
    wavelengths_of,
)
from scanhsi.devices.errors import CubeError
from support.cubes import whole, write_cube

WAVELENGTH = np.linspace(400, 900, 11)
SPEC = CubeSpec(30, 11, 9, "uint16", 12, {"simulated": True}, WAVELENGTH)
LOST = (4, 17)


@pytest.fixture(scope="module")
def cube(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Thirty lines planned, 26 reached, two of them lost."""
    path = tmp_path_factory.mktemp("spectra") / "a.zarr"
    clock.run(write_cube(path, SPEC, reach=26, missing=dict.fromkeys(LOST, "lost"), lines_per_shard=4), virtual=True)
    return path


@pytest.fixture(params=["plain", "dask"])
def dataset(cube: Path, request: pytest.FixtureRequest) -> xr.Dataset:
    return open_cube(cube, chunks=None if request.param == "plain" else "auto")


def reflectance(values: np.ndarray, wavelength: np.ndarray | None = None) -> xr.Dataset:
    coordinates: dict[str, Any] = {"status": ("line", np.ones(values.shape[1], np.uint8))}
    if wavelength is not None:
        coordinates["wavelength"] = ("band", wavelength)
    return xr.Dataset({"cube": (("band", "line", "sample"), values.astype(np.float32))}, coordinates)


def test_spectrum_of_a_pixel(dataset: xr.Dataset) -> None:
    np.testing.assert_array_equal(spectrum_at(dataset, 25, 8), whole(SPEC, 26)[:, 25, 8])
    for line, sample in ((26, 0), (-1, 0), (0, 9)):
        with pytest.raises(CubeError, match="there is no"):
            spectrum_at(dataset, line, sample)
    with pytest.raises(CubeError, match="line 17 is missing"):
        spectrum_at(dataset, 17, 0)


def test_region(dataset: xr.Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_BLOCK_BYTES", 8 * 11 * 4 * 3)  # three lines at a time
    found = region_spectrum(dataset, slice(2, 20), slice(3, 7))
    kept = [line for line in range(2, 20) if line not in LOST]
    pixels = whole(SPEC, 26)[:, kept, 3:7].reshape(11, -1).astype(float)
    np.testing.assert_allclose(found.mean, pixels.mean(axis=1), rtol=1e-12)
    np.testing.assert_allclose(found.sigma, pixels.std(axis=1, ddof=1), rtol=1e-12)
    np.testing.assert_array_equal(found.count, 16 * 4)
    assert (found.lines, found.samples) == ((2, 20), (3, 7))
    assert region_spectrum(dataset).count[0] == 24 * 9
    for lines, samples in ((slice(17, 18), slice(None)), (slice(0, 3), slice(5, 5)), (slice(26, 30), slice(None))):
        with pytest.raises(CubeError, match="hold no pixel"):
            region_spectrum(dataset, lines, samples)


def test_nan_does_not_count() -> None:
    values = 1e6 + np.random.default_rng(1).normal(size=(3, 40, 5))
    values[1, 7:9] = np.nan
    values[2] = np.nan
    found = region_spectrum(reflectance(values))
    known = values.astype(np.float32).astype(float)
    np.testing.assert_array_equal(found.count, [200, 190, 0])
    np.testing.assert_allclose(found.mean[:2], [known[0].mean(), np.nanmean(known[1])], rtol=1e-12)
    np.testing.assert_allclose(found.sigma[:2], [known[0].std(ddof=1), np.nanstd(known[1], ddof=1)], rtol=1e-9)
    assert np.isnan(found.mean[2])
    assert np.isnan(found.sigma[2])
    assert np.isnan(region_spectrum(reflectance(values), slice(0, 1), slice(0, 1)).sigma).all()


def test_random_pixels(dataset: xr.Dataset) -> None:
    found = random_spectra(dataset, 60, seed=3)
    assert found.values.shape == (60, 11)
    assert not set(found.lines.tolist()) & set(LOST)
    assert len(set(zip(found.lines.tolist(), found.samples.tolist(), strict=True))) == 60
    np.testing.assert_array_equal(found.values, whole(SPEC, 26)[:, found.lines, found.samples].T)
    np.testing.assert_array_equal(random_spectra(dataset, 60, seed=3).values, found.values)
    assert not np.array_equal(random_spectra(dataset, 60, seed=4).lines, found.lines)
    assert len(random_spectra(dataset, 5000).values) == 24 * 9


def test_random_pixels_that_are_no_numbers_are_drawn_anew() -> None:
    values = np.ones((2, 50, 4))
    values[:, ::2] = np.nan
    values[1, 1] = np.nan
    found = random_spectra(reflectance(values), 30)
    assert len(found.values) == 30
    assert (found.lines % 2 == 1).all()
    with pytest.raises(CubeError, match="no pixel that is a number"):
        random_spectra(reflectance(np.full((2, 5, 4), np.nan)))


def test_bands_and_ratios(dataset: xr.Dataset) -> None:
    raw = whole(SPEC, 26).astype(float)
    picture = band_picture(dataset, 640)
    assert np.isnan(picture[list(LOST)]).all()
    kept = [line for line in range(26) if line not in LOST]
    np.testing.assert_array_equal(picture[kept], raw[5, kept])  # 650 nm is the nearest
    np.testing.assert_array_equal(band_picture(dataset, 640, 101)[kept], raw[4:7, kept].mean(axis=0))
    np.testing.assert_array_equal(band_ratio(dataset, 500, 900)[kept], raw[2, kept] / raw[10, kept])
    assert bands_near(WAVELENGTH[::-1], 860) == slice(1, 2)
    assert np.isnan(ratio_of(np.ones(3), np.array([0.0, -1.0, np.nan]))).all()
    bare = reflectance(np.ones((2, 3, 4)))
    assert wavelengths_of(bare) is None
    with pytest.raises(CubeError, match="no wavelengths"):
        band_picture(bare, 500)


def test_gaps_in_spectra_are_bridged_where_they_are_small() -> None:
    values = np.linspace(0, 1, 40)[:, None, None] * np.ones((1, 3, 4))
    holes = values.copy()
    holes[[0, 20, 39], [0, 0, 0], [0, 1, 2]] = np.nan  # one band each
    holes[5:30, 1, 1] = np.nan
    weights = np.ones((1, 40), np.float32) / 40
    whole_picture, picture = (
        shrink(reflectance(one), [Weighted(slice(0, 40), weights)], (1, 1))[0][0] for one in (values, holes)
    )
    np.testing.assert_allclose(picture[0], whole_picture[0], atol=1 / 39 / 39)
    assert np.isnan(picture[1, 1])
    np.testing.assert_allclose(picture[2], whole_picture[2], rtol=1e-6)
    (means,) = shrink(reflectance(values), [Means(np.array([0, 10, 40]))], (2, 3))
    assert means.shape == (2, 2, 2)
    np.testing.assert_allclose(means[:, 1, 1], [values[:10].mean(), values[10:].mean()], rtol=1e-6)
