import math

import numpy as np
import pytest

from scanhsi.calibration.photon_transfer import FlatPair, PhotonTransfer, photon_transfer
from scanhsi.calibration.result import Provenance, load, save
from scanhsi.devices.errors import CalibrationError
from support.flats import DSNU_E, FULL_E, GAIN, PRNU, READ_E, SHAPE, pairs


def test_the_truth_is_recovered():
    result = photon_transfer(list(pairs(np.random.default_rng(1), 24)), Provenance())
    assert result.gain == pytest.approx(GAIN, rel=0.01)
    assert abs(result.gain - GAIN) < 4 * result.gain_sigma
    assert result.read_noise_e == pytest.approx(READ_E, rel=0.02)
    assert 0.9 * FULL_E < result.saturation_e <= FULL_E  # the last exposure before pixels clip; they are 5 % apart
    assert result.full_well_e == pytest.approx(FULL_E, rel=0.005)
    assert result.prnu == pytest.approx(PRNU, rel=0.1)
    assert result.dsnu_e == pytest.approx(DSNU_E, rel=0.1)
    assert result.snr_max_db == pytest.approx(10 * math.log10(FULL_E), abs=0.5)
    assert result.dynamic_range_db == pytest.approx(20 * math.log10(FULL_E / (READ_E + 0.5)), abs=1.0)
    assert result.linearity_error < 0.005


def test_the_full_well_is_not_known_where_the_signal_still_grows():
    result = photon_transfer(list(pairs(np.random.default_rng(5), 24, top=1.0)), Provenance())
    assert math.isnan(result.full_well_e)
    assert result.saturation_e > 0.9 * FULL_E


def test_gain_and_noise_are_taken_from_more_pixels_than_those_lit_evenly():
    some = np.zeros(SHAPE, bool)
    some[:5, :40] = True
    few = photon_transfer(list(pairs(np.random.default_rng(6), 24)), Provenance(), mask=some)
    many = photon_transfer(list(pairs(np.random.default_rng(6), 24)), Provenance(), mask=some, lit=np.ones(SHAPE, bool))
    assert many.gain_sigma < few.gain_sigma / 10
    assert many.gain == pytest.approx(GAIN, rel=0.005)
    assert many.read_noise_e == pytest.approx(READ_E, rel=0.005)


def test_dark_current_is_no_read_noise():
    rng = np.random.default_rng(7)

    def longer(pair: FlatPair) -> FlatPair:
        current = GAIN * rng.poisson(400 * pair.exposure_s, (2, 2, *SHAPE))
        return FlatPair(pair.exposure_s, pair.flat + np.rint(current[0]), pair.dark + np.rint(current[1]))

    result = photon_transfer([longer(pair) for pair in pairs(rng, 24)], Provenance())
    assert result.read_noise_e == pytest.approx(READ_E, rel=0.04)


def test_a_bent_response_shows():
    straight = photon_transfer(list(pairs(np.random.default_rng(2), 16)), Provenance())
    bent = photon_transfer(list(pairs(np.random.default_rng(2), 16, top=1.6, bend=0.15)), Provenance())
    assert bent.linearity_error > 4 * straight.linearity_error


def test_it_survives_a_file(tmp_path):
    result = photon_transfer(list(pairs(np.random.default_rng(3), 10)), Provenance(("flats.zarr",)))
    save(result, tmp_path / "ptc.nc")
    again = load(PhotonTransfer, tmp_path / "ptc.nc")
    assert again.gain == result.gain
    np.testing.assert_array_equal(again.variance, result.variance)


def test_what_does_not_do_is_refused():
    rng = np.random.default_rng(4)
    good = list(pairs(rng, 8))
    with pytest.raises(CalibrationError, match="five exposures"):
        photon_transfer(good[:4], Provenance())
    with pytest.raises(CalibrationError, match="no flat is saturated"):
        photon_transfer(list(pairs(rng, 8, top=0.6)), Provenance())
    dark = [FlatPair(pair.exposure_s, pair.dark, pair.dark) for pair in good]
    with pytest.raises(CalibrationError, match="no light"):
        photon_transfer(dark, Provenance())
    odd = [*good[:-1], FlatPair(9.0, good[0].flat[:, :-1], good[0].dark)]
    with pytest.raises(CalibrationError, match="two flat and two dark frames"):
        photon_transfer(odd, Provenance())
    with pytest.raises(CalibrationError, match="the mask leaves 3"):
        photon_transfer(good, Provenance(), mask=np.arange(SHAPE[0] * SHAPE[1]).reshape(SHAPE) < 3)
    lost = [FlatPair(pair.exposure_s, np.where(pair.flat > 0, np.nan, 0.0), pair.dark) for pair in good]
    with pytest.raises(CalibrationError, match="no numbers"):
        photon_transfer(lost, Provenance())
