import math

import numpy as np
import pytest

from scanhsi.calibration.light import allan_deviation, light_stability
from scanhsi.calibration.result import Provenance
from scanhsi.calibration.snr import signal_to_noise
from scanhsi.devices.errors import CalibrationError


@pytest.mark.parametrize("reflectance", [0.9, 0.5, 0.1])
def test_both_definitions_differ_by_the_reflectance(reflectance: float):
    rng = np.random.default_rng(1)
    values = rng.normal(reflectance, 0.02 * reflectance, (4, 400, 60))
    result = signal_to_noise({0.1: values}, Provenance())
    np.testing.assert_allclose(result.snr_db, 20 * math.log10(50), atol=0.1)
    np.testing.assert_allclose(result.snr_paper_db - result.snr_db, -10 * math.log10(reflectance), atol=0.02)


def test_unevenness_is_spatial_and_not_noise():
    rng = np.random.default_rng(2)
    pattern = 1 + 0.05 * rng.standard_normal((3, 1, 200))
    result = signal_to_noise({0.1: 0.8 * pattern * rng.normal(1, 0.01, (3, 300, 200))}, Provenance())
    np.testing.assert_allclose(result.snr_db, 40, atol=0.2)
    np.testing.assert_allclose(result.spatial_db, 20 * math.log10(1 / 0.05), atol=1.0)


def test_of_counts_equation_20_means_nothing():
    values = np.random.default_rng(3).normal(1000, 10, (2, 50, 20))
    result = signal_to_noise({0.1: values, 0.05: values}, Provenance())
    assert np.isnan(result.snr_paper_db).all()
    assert result.exposure_s.tolist() == [0.05, 0.1]


@pytest.mark.parametrize(
    ("captures", "why"),
    [
        ({}, "nothing"),
        ({0.1: np.ones((2, 2, 5))}, "show no noise"),
        ({0.1: np.ones((2, 5, 5)), 0.2: np.ones((2, 5, 6))}, "different bands or samples"),
    ],
)
def test_no_signal_to_noise_from_nothing(captures: dict, why: str):
    with pytest.raises(CalibrationError, match=why):
        signal_to_noise(captures, Provenance())


def test_a_lamp_that_warms_up_is_fitted():
    rng = np.random.default_rng(4)
    time = np.arange(0, 800.0, 40)
    level = 2000 * (1 + 0.15 * np.exp(-time / 120)) * rng.normal(1, 0.002, len(time))
    result = light_stability(time, level, Provenance())
    assert result.settling_s == pytest.approx(120, abs=4 * result.settling_sigma_s)
    assert result.settling_sigma_s < 15
    assert result.level == pytest.approx(2000, rel=0.005)
    assert result.overshoot == pytest.approx(0.15, rel=0.1)
    assert result.stable_after_s == pytest.approx(120 * math.log(15), rel=0.15)
    assert result.residual == pytest.approx(0.002, rel=0.5)


def test_a_settled_lamp_gets_no_time_constant_out_of_noise():
    rng = np.random.default_rng(5)
    found = [
        math.isnan(light_stability(np.arange(40.0), rng.normal(1000, 5, 40), Provenance()).settling_s)
        for _ in range(40)
    ]
    assert sum(found) >= 38


def test_drift_is_told_in_parts_a_minute():
    time = np.arange(0, 1200.0, 10)
    level = 1000 * (1 + 0.001 * time / 60) * np.random.default_rng(6).normal(1, 1e-4, len(time))
    result = light_stability(time, level, Provenance())
    total = result.drift_per_min if math.isnan(result.settling_s) else np.nan
    assert np.isnan(total) or total == pytest.approx(0.001, rel=0.05)


def test_allan_deviation_of_white_noise_falls_with_the_root_of_time():
    averaging, deviation = allan_deviation(np.random.default_rng(7).normal(1, 0.01, 20_000), 0.5)
    np.testing.assert_allclose(averaging[:4], [0.5, 1, 2, 4])
    np.testing.assert_allclose(deviation[:8], 0.01 / np.sqrt(averaging[:8] / 0.5), rtol=0.1)


@pytest.mark.parametrize(
    ("time", "level", "why"),
    [
        (np.arange(5.0), np.ones(5), "8 snapshots"),
        (np.zeros(10), np.ones(10), "do not rise"),
        (np.arange(10.0), np.full(10, np.nan), "no numbers"),
        (np.arange(10.0), np.zeros(10), "no light"),
    ],
)
def test_no_stability_from_what_is_none(time, level, why: str):
    with pytest.raises(CalibrationError, match=why):
        light_stability(time, level, Provenance())
