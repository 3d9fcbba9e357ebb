import numpy as np
import pytest

from scanhsi.calibration.peaks import find_peaks, gaussian, noise_of
from scanhsi.devices.errors import CalibrationError

PIXEL = np.arange(300.0)


def spectrum(*peaks: tuple[float, float, float], noise: float = 0.0, seed: int = 0, slope: float = 0.02) -> np.ndarray:
    values = 20 + slope * PIXEL + np.random.default_rng(seed).normal(0, noise, 300)
    for centre, fwhm, height in peaks:
        values = values + gaussian(PIXEL, centre, fwhm, height)
    return values


def test_a_place_to_a_thousandth_of_a_pixel_without_noise():
    peaks = find_peaks(spectrum((40.3, 5.0, 1000), (200.72, 5.8, 100)))
    np.testing.assert_allclose(peaks.centre_px, [40.3, 200.72], atol=1e-3)
    np.testing.assert_allclose(peaks.fwhm_px, [5.0, 5.8], rtol=1e-3)
    np.testing.assert_allclose(peaks.height, [1000, 100], rtol=1e-3)


def test_errors_are_what_they_say():
    pulls, widths = [], []
    for seed in range(80):
        peaks = find_peaks(spectrum((150.4, 5.5, 500), noise=5, seed=seed))
        nearest = int(np.argmin(np.abs(peaks.centre_px - 150.4)))
        pulls.append((peaks.centre_px[nearest] - 150.4) / peaks.centre_sigma_px[nearest])
        widths.append((peaks.fwhm_px[nearest] - 5.5) / peaks.fwhm_sigma_px[nearest])
    assert 0.75 < np.std(pulls) < 1.3
    assert 0.75 < np.std(widths) < 1.3
    assert abs(np.mean(pulls)) < 0.4


def test_neighbours_that_overlap_are_fitted_together():
    peaks = find_peaks(spectrum((100.0, 5.5, 1000), (107.4, 5.5, 600), noise=1))
    assert len(peaks) == 2
    np.testing.assert_allclose(peaks.centre_px, [100.0, 107.4], atol=0.02)
    np.testing.assert_allclose(peaks.height, [1000, 600], rtol=0.01)


def test_noise_is_no_peak():
    found = [len(find_peaks(spectrum((150.4, 5.5, 300), noise=5, seed=seed))) for seed in range(40)]
    assert max(found) <= 2
    assert np.mean(found) < 1.1
    with pytest.raises(CalibrationError, match=r"out of the noise|shape of a line"):
        find_peaks(spectrum(noise=3))


def test_hot_pixels_are_no_lines():
    values = spectrum((150.4, 5.5, 300), noise=2)
    values[[30, 222]] += 500
    assert find_peaks(values).centre_px == pytest.approx([150.4], abs=0.05)


def test_noise_is_told_from_a_slope():
    assert noise_of(spectrum(noise=5, slope=3.0)) == pytest.approx(5, rel=0.2)


@pytest.mark.parametrize(
    ("values", "why"),
    [
        (np.ones(10), "16 pixels"),
        (np.ones((20, 20)), "16 pixels"),
        (np.where(PIXEL == 7, np.nan, 1.0), "first at 7"),
        (np.zeros(100), "out of the noise"),
    ],
)
def test_what_is_no_spectrum_is_refused(values: np.ndarray, why: str):
    with pytest.raises(CalibrationError, match=why):
        find_peaks(values)
