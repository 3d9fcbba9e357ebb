import numpy as np
import pytest
from scipy import special

from scanhsi.calibration.keystone import Keystone, fit_keystone
from scanhsi.calibration.result import Provenance, load, save
from scanhsi.devices.errors import CalibrationError

BANDS, SAMPLES = 400, 480
U = (2 * np.arange(BANDS) / (BANDS - 1) - 1)[:, None]
T = 2 * np.arange(SAMPLES) / (SAMPLES - 1) - 1
SPECTRUM = 200 + 3000 * np.exp(-((U * 1.2) ** 2))


def shift(c: np.ndarray) -> np.ndarray:
    return c[0][0] * U + c[0][1] * U * T + c[1][0] * U**2 + c[1][1] * U**2 * T


def grid(c: list[list[float]], pitch: float = 31.7, noise: float = 0.0, seed: int = 0) -> np.ndarray:
    """White cells with black lines 4 samples wide, blurred by a sample."""
    place = np.arange(SAMPLES) - shift(np.array(c))
    lines = np.zeros((BANDS, SAMPLES))
    for at in np.arange(11.3, SAMPLES, pitch):
        lines += special.ndtr(place - at + 2) - special.ndtr(place - at - 2)
    return SPECTRUM * (1 - 0.9 * lines) * (1 - 0.2 * T**2) + np.random.default_rng(seed).normal(0, noise, lines.shape)


TRUTH = [[0.12, 0.6], [-0.08, 0.1]]


def test_keystone_to_a_hundredth_of_a_sample_from_a_grid():
    found = fit_keystone(grid(TRUTH, noise=20), Provenance())
    assert np.abs(found.shift() - shift(np.array(TRUTH))).max() < 0.02
    assert np.abs((found.coefficients - TRUTH) / found.coefficients_sigma).max() < 4
    assert found.largest_samples == pytest.approx(np.ptp(shift(np.array(TRUTH)), axis=0).max(), abs=0.02)


def test_one_slanting_edge_tells_its_own_shift():
    place = np.arange(SAMPLES) - shift(np.array([[0.5, 0.0], [0.1, 0.0]]))
    frame = SPECTRUM * special.ndtr((place - 240.2) / 1.5) + np.random.default_rng(1).normal(0, 10, (BANDS, SAMPLES))
    found = fit_keystone(frame, Provenance())
    np.testing.assert_allclose(found.coefficients[:, 0], [0.5, 0.1], atol=0.02)
    assert (found.coefficients[:, 1] == 0).all()
    assert np.isnan(found.coefficients_sigma[:, 1]).all()


def test_no_keystone_is_none():
    found = fit_keystone(grid([[0, 0], [0, 0]], noise=20, seed=2), Provenance())
    assert found.largest_samples < 0.02


def test_a_wall_without_structure_is_refused():
    wall = SPECTRUM * np.ones(SAMPLES) + np.random.default_rng(3).normal(0, 20, (BANDS, SAMPLES))
    with pytest.raises(CalibrationError, match="no structure"):
        fit_keystone(wall, Provenance())
    with pytest.raises(CalibrationError, match="32 samples"):
        fit_keystone(np.zeros((400, 20)), Provenance())


def test_saturated_bands_are_left_out_unless_they_are_the_middle():
    frame = grid(TRUTH, noise=20)
    frame[300:330, 100:200] = np.nan
    assert np.abs(fit_keystone(frame, Provenance()).shift() - shift(np.array(TRUTH))).max() < 0.02
    frame[:, 50] = np.nan
    with pytest.raises(CalibrationError, match="saturated"):
        fit_keystone(frame, Provenance())


def test_it_survives_a_file(tmp_path):
    found = fit_keystone(grid(TRUTH, noise=20), Provenance(("grid.zarr",)))
    save(found, tmp_path / "keystone.nc")
    np.testing.assert_array_equal(load(Keystone, tmp_path / "keystone.nc").shift(), found.shift())
