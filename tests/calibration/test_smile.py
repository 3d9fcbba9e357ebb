import numpy as np
import pytest

from scanhsi.calibration.result import Provenance, load, save
from scanhsi.calibration.smile import Smile, calibrate_spectrograph
from scanhsi.devices.errors import CalibrationError
from support.lamps import BANDS, TRUTH_NM, lamp, noisy

SAMPLES = 240


def bent(slant: float = 0.3, bend: float = 0.8, turn: float = 0.15) -> np.ndarray:
    """Shift of (band, sample)."""
    u = (2 * BANDS / 1087 - 1)[:, None]
    t = (np.arange(SAMPLES) - (SAMPLES - 1) / 2) / (SAMPLES / 2)
    return (slant + turn * u) * t + (bend + turn * u) * t**2


@pytest.fixture(scope="module")
def calibrated():
    return calibrate_spectrograph(noisy(lamp(bent()), 1, 20), Provenance(("lamp.zarr",)))


def test_smile_to_a_hundredth_of_a_band_everywhere(calibrated):
    wavelength, smile = calibrated
    assert np.abs(smile.shift() - bent()).max() < 0.01
    assert np.sqrt(np.mean((wavelength.nm() - TRUTH_NM) ** 2)) < 0.01
    assert smile.largest_bands == pytest.approx(np.ptp(bent(), axis=1).max(), abs=0.02)
    pulls = (smile.coefficients - [[0.3, 0.8], [0.15, 0.15]]) / smile.coefficients_sigma
    assert np.abs(pulls).max() < 4


def test_the_wavelength_of_every_pixel(calibrated):
    wavelength, smile = calibrated
    pixels = smile.wavelength_map(wavelength)
    assert pixels.shape == (1088, SAMPLES)
    for sample in (0, 60, 239):
        there = BANDS + bent()[:, sample]  # where the light of TRUTH_NM falls
        inside = (there > 0) & (there < 1087)
        np.testing.assert_allclose(np.interp(there[inside], BANDS, pixels[:, sample]), TRUTH_NM[inside], atol=0.02)


def test_resolution_along_the_slit(calibrated):
    _, smile = calibrated
    assert smile.line_fwhm_nm.shape == (len(smile.line_nm), len(smile.block))
    assert np.nanmedian(smile.line_fwhm_nm) == pytest.approx(2.9, rel=0.01)


def test_a_slit_turned_by_nine_bands():
    """As the one of a public OpenHSI calibration."""
    _, smile = calibrate_spectrograph(noisy(lamp(bent(4.5, 0.8, 0.0)), 2, 20), Provenance())
    assert np.abs(smile.shift() - bent(4.5, 0.8, 0.0)).max() < 0.02


def test_samples_without_light_and_saturated_ones_spoil_only_themselves():
    frame = noisy(lamp(bent()), 3, 20)
    frame[:, :30] = noisy(np.zeros((1088, 30)), 4, 20)
    frame[330:340, 200:] = np.nan
    _, smile = calibrate_spectrograph(frame, Provenance())
    assert np.abs(smile.shift() - bent())[:, 30:].max() < 0.03


def test_too_few_samples_or_no_frame():
    with pytest.raises(CalibrationError, match="120 at least"):
        calibrate_spectrograph(noisy(lamp(bent()[:, :100]), 5, 20), Provenance())
    with pytest.raises(CalibrationError, match="bands and samples"):
        calibrate_spectrograph(lamp(), Provenance())


def test_it_survives_a_file(tmp_path, calibrated):
    _, smile = calibrated
    save(smile, tmp_path / "smile.nc")
    np.testing.assert_array_equal(load(Smile, tmp_path / "smile.nc").shift(), smile.shift())
