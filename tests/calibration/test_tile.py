import numpy as np
import pytest

from scanhsi.calibration.assign import DispersionRange
from scanhsi.calibration.lines import line_list
from scanhsi.calibration.result import Provenance, load, save
from scanhsi.calibration.tile import calibrate_with_tile, continuum_removed, find_minima
from scanhsi.calibration.wavelength import Wavelength
from scanhsi.devices.errors import CalibrationError
from support.lamps import BANDS, TRUTH_NM

MINIMA = [402.1, 421.4, 446.0, 460.7, 487.2, 522.3, 541.0, 653.1, 744.8, 799.2, 879.9, 907.5]
"""Synthetic: roughly where rare earths absorb, no certificate of any tile."""


def tile(noise: float = 0.002, seed: int = 0, minima: list[float] = MINIMA) -> np.ndarray:
    rng = np.random.default_rng(seed)
    values = 0.9 - 0.1 * ((TRUTH_NM - 700) / 300) ** 2
    for index, nm in enumerate(minima):
        values = values * (1 - (0.1 + 0.04 * (index % 4)) * np.exp(-(((TRUTH_NM - nm) / 5.5) ** 2)))
    return values + rng.normal(0, noise, len(values))


def test_minima_to_a_tenth_of_a_nanometre():
    places, sigma = find_minima(tile(), fwhm_bands=18)
    nm = np.interp(places, BANDS, TRUTH_NM)
    nearest = np.array([np.abs(np.array(MINIMA) - one).min() for one in nm])
    assert len(places) == len(MINIMA)
    assert nearest.max() < 0.6
    assert np.median(nearest) < 0.15
    assert (sigma < 0.5).all()


def test_the_continuum_is_a_hull():
    values = tile(noise=0)
    flat = continuum_removed(values)
    assert flat.max() == pytest.approx(1)
    assert flat.min() == pytest.approx(0.78, abs=0.01)
    np.testing.assert_allclose(continuum_removed(1 + 0.1 * BANDS), 1)


def test_wavelengths_from_a_tile():
    for seed in range(3):
        found = calibrate_with_tile(tile(seed=seed), line_list("synthetic", MINIMA), Provenance(), fwhm_bands=18)
        assert np.sqrt(np.mean((found.nm() - TRUTH_NM) ** 2)) < 0.3
        assert np.isnan(found.fwhm_nm(600.0))


def test_minima_that_are_not_in_the_certificate_and_lines_that_do_not_show():
    strange = [*MINIMA[:3], *MINIMA[5:], 600.0, 700.0, 840.0]
    found = calibrate_with_tile(tile(minima=strange), line_list("synthetic", MINIMA), Provenance(), fwhm_bands=18)
    assert np.sqrt(np.mean((found.nm() - TRUTH_NM) ** 2)) < 0.6
    assert not np.isin(found.line_nm, [460.7, 487.2]).any()


def test_it_survives_a_file(tmp_path):
    found = calibrate_with_tile(tile(), line_list("synthetic", MINIMA), Provenance(("tile.zarr",)), fwhm_bands=18)
    save(found, tmp_path / "tile.nc")
    np.testing.assert_array_equal(load(Wavelength, tmp_path / "tile.nc").nm(), found.nm())


def test_what_is_no_tile_is_refused():
    certificate = line_list("synthetic", MINIMA)
    with pytest.raises(CalibrationError, match=r"noise|absorption|shape|too few|no dispersion"):
        calibrate_with_tile(
            np.full(1088, 0.99) + np.random.default_rng(1).normal(0, 0.002, 1088), certificate, Provenance()
        )
    with pytest.raises(CalibrationError, match="gaps"):
        continuum_removed(np.where(BANDS == 5, np.nan, 1.0))
    with pytest.raises(CalibrationError, match="reflects nothing"):
        continuum_removed(np.zeros(10))
    prior = DispersionRange(nm_per_band=(1.0, 1.2), first_nm=(340, 430))
    with pytest.raises(CalibrationError, match="no dispersion"):
        calibrate_with_tile(tile(), certificate, Provenance(), prior=prior, fwhm_bands=18)
