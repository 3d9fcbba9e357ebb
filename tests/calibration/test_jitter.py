import math

import numpy as np
import pytest

from scanhsi.calibration.backlash import backlash_steps
from scanhsi.calibration.jitter import clipped_sigma, jitter
from scanhsi.calibration.result import Provenance
from scanhsi.calibration.slanted import displacements
from scanhsi.devices.errors import CalibrationError


def residuals(rng, lines: int, sigma: float = 0.2, misaligned: float = 0.35):
    phase = np.linspace(-math.pi / 4, math.pi * 7 / 4, lines)  # a whole turn
    return phase, rng.normal(0, sigma, lines) + misaligned * np.cos(phase + 0.3)


@pytest.mark.parametrize(("lines", "within"), [(40, 0.04), (520, 0.01), (1200, 0.006)])
def test_jitter_beside_a_misalignment(lines: int, within: float):
    rng = np.random.default_rng(lines)
    fits = [jitter(*residuals(rng, lines), Provenance()) for _ in range(80)]
    sigma = np.array([fit.sigma_mm for fit in fits])
    assert sigma.mean() == pytest.approx(0.2, rel=0.03)
    assert np.std(sigma) < within
    assert np.std(sigma) == pytest.approx(np.mean([fit.sigma_error_mm for fit in fits]), rel=0.35)
    assert np.mean([fit.misalignment_mm for fit in fits]) == pytest.approx(0.35, abs=0.06)
    assert np.mean([fit.raw_mm for fit in fits]) > 0.29


def test_the_papers_estimate_is_a_few_percent_low():
    rng = np.random.default_rng(1)
    clipped = [clipped_sigma(residuals(rng, 1200)[1]) for _ in range(60)]
    assert 0.188 < np.mean(clipped) < 0.199  # 0.194 +- 0.004 by an independent simulation


def test_jitter_of_every_scan_line_from_a_slanted_target():
    rng = np.random.default_rng(2)
    slope, pitch_mm, period_mm = math.tan(math.radians(10)), 0.1, 2.0
    true = rng.normal(0, 0.2, 520)
    y = 0.2282 * np.arange(520) + true
    x = pitch_mm * np.arange(1200)
    place = (x[None, :] * slope - y[:, None]) * math.cos(math.radians(10))  # across the slanted lines
    lines = 500 + 300 * np.cos(2 * math.pi * place / period_mm) + rng.normal(0, 10, place.shape)
    found = displacements(lines, slope, pitch_mm)
    trend = np.polyval(np.polyfit(np.arange(520), true, 1), np.arange(520))
    np.testing.assert_allclose(found, true - trend, atol=0.02)
    assert np.std(found) == pytest.approx(0.2, rel=0.1)


@pytest.mark.parametrize("shift", [-7.3, -0.4, 0.0, 0.25, 3.7])
def test_backlash_within_a_tenth_of_a_step(shift: float):
    rng = np.random.default_rng(3)
    steps = np.arange(300.0)
    scene = np.cumsum(rng.normal(0, 1, 700))
    scene = np.convolve(scene, np.hanning(15) / 7, "same")
    place = np.arange(-200.0, 500.0)
    forward = np.interp(steps, place, scene) + rng.normal(0, 0.05, 300)
    backward = np.interp(steps + shift, place, scene) + rng.normal(0, 0.05, 300)
    assert backlash_steps(forward, backward) == pytest.approx(shift, abs=0.1)


def test_what_says_nothing_is_refused():
    with pytest.raises(CalibrationError, match="a finer grid"):
        jitter(np.arange(5.0), np.arange(5.0), Provenance())
    with pytest.raises(CalibrationError, match="no numbers"):
        jitter(np.arange(20.0), np.full(20, np.nan), Provenance())
    with pytest.raises(CalibrationError, match="no pattern"):
        displacements(np.random.default_rng(1).normal(size=(40, 64)), 0.2, 0.1)
    with pytest.raises(CalibrationError, match="nothing varies"):
        backlash_steps(np.ones(30), np.ones(30))
    with pytest.raises(CalibrationError, match="16 lines"):
        backlash_steps(np.arange(30.0), np.arange(31.0))
