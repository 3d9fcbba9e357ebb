import numpy as np
import pytest

from scanhsi.calibration.assign import DispersionRange, assign_lines
from scanhsi.calibration.lines import hgar, line_list
from scanhsi.devices.errors import CalibrationError

BANDS = np.arange(1088.0)
TRUTH_NM = 370.79 + 0.536 * BANDS - 4e-6 * BANDS**2
LINES = hgar().merged(1.8).calibrating().within(380, 946)
PLACES = np.interp(LINES.wavelength_nm, TRUTH_NM, BANDS)


def seen(seed: int, missing: float, spurious: float) -> tuple[np.ndarray, np.ndarray]:
    """Peaks in any order, and the line of each, -1 for none."""
    rng = np.random.default_rng(seed)
    kept = rng.choice(len(PLACES), round((1 - missing) * len(PLACES)), replace=False)
    wrong = round(len(kept) * spurious / (1 - spurious))
    places = np.concatenate([PLACES[kept] + rng.normal(0, 0.1, len(kept)), rng.uniform(0, 1087, wrong)])
    line = np.concatenate([kept, np.full(wrong, -1)])
    order = rng.permutation(len(places))
    return places[order], line[order]


@pytest.mark.parametrize("seed", range(12))
def test_a_third_of_the_lines_missing_and_a_third_of_the_peaks_wrong(seed: int):
    places, line = seen(seed, 0.3, 0.3)
    found = assign_lines(places, LINES)
    real = line[found.peak] >= 0
    np.testing.assert_array_equal(line[found.peak][real], found.line[real])
    assert real.sum() >= 0.95 * (line >= 0).sum()
    assert (~real).sum() <= 1  # one that happens to lie on a line
    assert np.abs(found.dispersion.nm(BANDS) - TRUTH_NM).max() < 0.6
    assert found.rival < 0.7 * found.score


def test_a_sensor_mounted_the_other_way_round():
    places, line = seen(3, 0.2, 0.2)
    flipped = DispersionRange(nm_per_band=(-0.65, -0.45), first_nm=(900, 1000))
    found = assign_lines(1087 - places, LINES, prior=flipped)
    real = line[found.peak] >= 0
    np.testing.assert_array_equal(line[found.peak][real], found.line[real])


def test_the_order_of_the_peaks_does_not_matter():
    places, _ = seen(5, 0.3, 0.3)
    one, other = assign_lines(places, LINES), assign_lines(places[::-1], LINES)
    np.testing.assert_allclose(one.dispersion.coefficients, other.dispersion.coefficients, rtol=1e-9)
    assert (np.diff(one.peak) > 0).all()


def test_peaks_at_random_are_no_spectrum():
    rng = np.random.default_rng(6)
    with pytest.raises(CalibrationError, match=r"no dispersion|equally well"):
        assign_lines(np.sort(rng.uniform(0, 1087, 16)), LINES)


def test_lines_evenly_spaced_fit_more_than_one_way():
    comb = line_list("comb", np.arange(300.0, 1100.0, 20.0))
    places = np.interp(np.arange(400.0, 900.0, 20.0), TRUTH_NM, BANDS)
    with pytest.raises(CalibrationError, match="equally well"):
        assign_lines(places, comb, prior=DispersionRange(first_nm=(320, 420)))


def test_too_few_peaks_are_refused():
    with pytest.raises(CalibrationError, match="4 peaks and 24 lines"):
        assign_lines(PLACES[:4], LINES)
    with pytest.raises(CalibrationError, match="no row of numbers"):
        assign_lines([1.0, np.nan, 3, 4, 5, 6], LINES)
