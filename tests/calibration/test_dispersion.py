import numpy as np
import pytest

from scanhsi.calibration.dispersion import fit_dispersion, fit_dispersion_robustly
from scanhsi.devices.errors import CalibrationError

TRUTH = (370.79, 0.536, -4e-6)  # the paper's polynomial, per raw band instead of per channel of five

# Pixels and wavelengths of a WCS-MC-020 tile as students of a course posted them; the fourth and the last are assigned wrongly.
TILE_PX = np.array([96, 201, 251, 284, 528, 712, 795.5, 962, 988])
TILE_NM = np.array([423.217, 478.932, 502.810, 537.373, 650.216, 748.964, 797.834, 881.225, 911.206])


def curve(band: np.ndarray) -> np.ndarray:
    return np.polynomial.polynomial.polyval(band, TRUTH)


def test_of_nine_pairs_of_a_tile_exactly_the_two_wrong_ones_are_rejected():
    fit, good = fit_dispersion_robustly(TILE_PX, TILE_NM, degree=1)
    assert TILE_PX[~good].tolist() == [284, 988]
    assert fit.coefficients[0] == pytest.approx(371.15, abs=0.005)
    assert fit.coefficients[1] == pytest.approx(0.53169, abs=5e-6)
    assert fit.residual_nm == pytest.approx(2.2, abs=0.05)
    assert float(fit.nm(1088)) == pytest.approx(949.6, abs=0.1)
    everything = fit_dispersion(TILE_PX, TILE_NM, degree=1)
    assert np.abs(TILE_NM - everything.nm(TILE_PX)).max() > 12


@pytest.mark.parametrize("middle", [795, 796])
def test_whichever_of_the_two_pixels_posted_is_taken(middle: float):
    places = np.where(TILE_PX == 795.5, middle, TILE_PX)
    _, good = fit_dispersion_robustly(places, TILE_NM, degree=1)
    assert TILE_PX[~good].tolist() == [284, 988]


def test_wrong_pairs_do_not_matter_and_good_ones_stay():
    kept = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        band = np.sort(rng.uniform(0, 1088, 14))
        known = curve(band) + rng.normal(0, 0.05, 14)
        wrong = rng.choice(14, 4, replace=False)
        known[wrong] += rng.choice([-1, 1], 4) * rng.uniform(3, 15, 4)
        _, good = fit_dispersion_robustly(band, known)
        assert not good[wrong].any()
        kept.append(good.sum())
    assert np.mean(kept) > 9.4  # of ten


def test_covariance_is_what_it_says():
    band = np.linspace(50, 1000, 12)
    at = np.array([0.0, 500.0, 1087.0])
    pulls = []
    for seed in range(200):
        fit = fit_dispersion(band, curve(band) + np.random.default_rng(seed).normal(0, 0.05, 12), sigma_nm=0.05)
        pulls.append((fit.nm(at) - curve(at)) / fit.sigma_nm(at))
    assert (np.abs(np.std(pulls, axis=0) - 0.95) < 0.15).all()  # below 1: where pairs scatter more, errors grow


def test_a_test_of_the_residuals_takes_degree_plus_three_pairs():
    rng = np.random.default_rng(1)
    for pairs, tested in [(4, False), (5, True)]:
        band = np.linspace(0, 1000, pairs)
        fit = fit_dispersion(band, curve(band) + rng.normal(0, 0.05, pairs), degree=2, sigma_nm=0.05)
        assert np.isfinite(fit.p_value) == tested
    band = np.linspace(0, 1000, 12)
    values = [fit_dispersion(band, curve(band) + rng.normal(0, 0.05, 12), sigma_nm=0.05).p_value for _ in range(200)]
    assert 0.4 < np.mean(values) < 0.6
    assert fit_dispersion(band, curve(band), degree=1, sigma_nm=0.05).p_value < 1e-6  # a line is not enough


def test_as_many_pairs_as_coefficients_are_the_least():
    band = np.array([0.0, 500, 1000])
    fit = fit_dispersion(band, curve(band), degree=2, sigma_nm=0.1)
    np.testing.assert_allclose(fit.coefficients, TRUTH, rtol=1e-9)
    assert np.isnan(fit.residual_nm)
    with pytest.raises(CalibrationError, match="3 coefficients: 2 places"):
        fit_dispersion(band[:2], curve(band[:2]), degree=2)


def test_slope_is_that_of_the_curve():
    fit = fit_dispersion(np.arange(0, 1000, 100), curve(np.arange(0, 1000, 100)))
    assert float(fit.nm_per_band(300)) == pytest.approx(0.536 - 8e-6 * 300)


@pytest.mark.parametrize(
    ("band", "known", "degree", "why"),
    [
        ([0, 1, 2], [1, 2], 1, "do not go together"),
        ([0, 1, np.nan], [1, 2, 3], 1, "no numbers"),
        ([5, 5, 5, 5], [1, 2, 3, 4], 1, "1 places are too few"),
        ([0, 1, 2], [1, 2, 3], 0, "no sensible"),
        ([0, 1, 2, 3], [1, 2, 3, 4], 2, "cannot tell a wrong one"),
    ],
)
def test_what_cannot_be_fitted_is_refused(band: list, known: list, degree: int, why: str):
    with pytest.raises(CalibrationError, match=why):
        fit_dispersion_robustly(band, known, degree=degree)


def test_errors_have_to_be_positive():
    with pytest.raises(CalibrationError, match="positive"):
        fit_dispersion([0, 1, 2], [1, 2, 3], degree=1, sigma_nm=0)
