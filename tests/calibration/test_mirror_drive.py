"""Repeatability, backlash of targets that repeat, and shafts out of true, from numbers made up for it."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from scanhsi.calibration.backlash import backlash, backlash_steps
from scanhsi.calibration.geometry import Geometry, fit_geometry
from scanhsi.calibration.jitter import jitter
from scanhsi.calibration.repeatability import Repeatability, repeatability
from scanhsi.calibration.result import Provenance, identity, load, save
from scanhsi.calibration.shaft import find_turn
from scanhsi.calibration.slanted import repeated_displacements
from scanhsi.devices.errors import CalibrationError

Floats = NDArray[np.float64]
STEP_RAD = 2 * math.pi / 19_200
PLANE = Geometry(348.73, 0.0, STEP_RAD, 0.1, 600.0, Provenance())
POSITIONS: Floats = np.linspace(-100, 100, 5)


def test_iso_230_2_by_hand() -> None:
    up = np.array([[0.0, 0, 0, 0, 0], [1, 1, 1, 1, 2], [2, 2, 2, 2, 4]])  # s = 1, 1, 1, 1, 2
    down = up + np.array([3.0, 3, 3, 3, 8])
    found = repeatability(up, down, POSITIONS, 0.2282, Provenance())
    np.testing.assert_allclose(found.deviation_sigma_steps, [[1, 1, 1, 1, 2]] * 2)
    assert found.reversal_steps == pytest.approx(4.0)
    assert found.reversal_sigma_steps == pytest.approx(1.0)
    assert (found.upwards_steps, found.downwards_steps) == (8, 8)
    assert found.repeatability_steps == 2 * 2 + 2 * 2 + 8
    assert found.sigma_steps == pytest.approx(math.sqrt(8 / 5))


def test_without_play_the_wider_direction_counts() -> None:
    rng = np.random.default_rng(1)
    up, down = rng.normal(0, 0.1, (5, 11)), rng.normal(0, 0.5, (5, 11))
    found = repeatability(up, down, np.arange(11.0), 0.2, Provenance())
    assert found.repeatability_steps >= found.downwards_steps > found.upwards_steps


def test_a_repeatability_is_the_same_after_a_file_and_named_by_what_it_holds(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    found = repeatability(rng.normal(0, 1, (5, 5)), rng.normal(0, 1, (5, 5)), POSITIONS, 0.2, Provenance())
    save(found, tmp_path / "a.nc")
    again = load(Repeatability, tmp_path / "a.nc")
    assert again.runs == 5
    assert identity(again) == identity(found)
    assert identity(replace(found, step_mm=0.3)) != identity(found)


@pytest.mark.parametrize(
    ("up", "down", "why"),
    [
        (np.zeros((2, 5)), np.zeros((2, 5)), "3 runs in either direction"),
        (np.zeros((5, 4)), np.zeros((5, 4)), "do not fit"),
        (np.zeros((5, 5)), np.zeros((4, 5)), "do not fit"),
        (np.full((5, 5), np.nan), np.zeros((5, 5)), "no numbers"),
    ],
)
def test_too_little_for_a_repeatability_is_refused(up: Floats, down: Floats, why: str) -> None:
    with pytest.raises(CalibrationError, match=why):
        repeatability(up, down, POSITIONS, 0.2, Provenance())


def stripes(rng: np.random.Generator, steps: Floats, jitter_steps: float, period: float = 8.9) -> Floats:
    """Slanted lines as scan lines see them, (line, sample)."""
    seen = steps + rng.normal(0, jitter_steps, len(steps))
    return 500 + 300 * np.cos(2 * np.pi * (seen[:, None] / period - np.arange(200.0) / 50))


def test_in_a_target_that_repeats_the_smallest_lag_is_meant() -> None:
    rng = np.random.default_rng(3)
    steps: Floats = np.arange(-150.0, 150.0)
    up, down = stripes(rng, steps, 0.5), stripes(rng, steps + 2.4, 0.5)
    assert backlash_steps(up, down) == pytest.approx(2.4, abs=0.2)
    found = backlash([up], [down], steps, 0.2282, Provenance())
    assert abs(found.lag_steps - 2.4) < 4 * found.lag_sigma_steps < 0.5
    assert found.lag_mm == pytest.approx(found.lag_steps * 0.2282)
    with pytest.raises(CalibrationError, match="as many scans upwards"):
        backlash([up, up], [down], steps, 0.2282, Provenance())
    with pytest.raises(CalibrationError, match="evenly spaced"):
        backlash([up], [down], steps**3, 0.2282, Provenance())
    with pytest.raises(CalibrationError, match="no numbers"):
        backlash_steps(np.where(up > 700, np.nan, up), down)


def test_displacements_from_scan_to_scan_and_those_too_large_to_tell() -> None:
    rng = np.random.default_rng(4)
    steps: Floats = np.linspace(-200, 200, 11)
    moved = rng.normal(0, 0.9, (6, 11))
    moved[3:] += 2.4  # so that some lie more than half a period from others
    assert np.ptp(moved, axis=0).max() > 8.9 / 2
    scans = [stripes(rng, steps + one, 0.0) for one in moved]
    found = np.concatenate(repeated_displacements(scans[:3], scans[3:])) * 8.9
    np.testing.assert_allclose(found, moved - moved.mean(axis=0), atol=0.03)
    with pytest.raises(CalibrationError, match="half a period"):
        repeated_displacements([stripes(rng, steps - 2.1, 0.0)], [stripes(rng, steps + 2.1, 0.0)])
    with pytest.raises(CalibrationError, match="differ in lines"):
        repeated_displacements(scans[:1], [scans[1][:-1]])


def test_the_turn_of_a_shaft_is_found_and_none_where_there_is_none() -> None:
    rng = np.random.default_rng(5)
    steps: Floats = np.arange(-280.0, 280.0)
    noise = rng.normal(0, 0.876, 560)
    slow = 2e-5 * steps**2
    assert find_turn(steps, noise + slow) is None
    turn = find_turn(steps, noise + slow + 1.5 * np.cos(2 * np.pi * steps / 320))
    assert turn == pytest.approx(320, rel=0.05)
    assert find_turn(steps, noise + 0.6 * np.cos(2 * np.pi * steps / 128)) == pytest.approx(128, rel=0.02)
    with pytest.raises(CalibrationError, match="too few"):
        find_turn(steps[:8], noise[:8])


def test_a_shaft_out_of_true_is_fitted_beside_the_distance() -> None:
    true = replace(PLANE, normal_step=7.3, turn_steps=320.0, shaft_cos_steps=1.5)
    y: Floats = 3.0 * np.arange(-21.0, 22.0)
    seen = true.step_of(y + np.random.default_rng(6).normal(0, 0.1, len(y)))
    start = replace(PLANE, distance_mm=350.0)
    plain = fit_geometry(seen, y, start, Provenance())
    fitted = fit_geometry(seen, y, start, Provenance(), turn=320.0)
    assert fitted.residual_mm < 0.5 * plain.residual_mm
    assert abs(fitted.distance_mm - 348.73) < 4 * fitted.distance_sigma_mm
    assert abs(fitted.shaft_steps - 1.5) < 4 * fitted.shaft_sigma_steps
    found = fit_geometry(seen, y, start, Provenance(), turn="find")
    assert found.turn_steps == pytest.approx(320, rel=0.1)
    np.testing.assert_allclose(true.step_of(true.y_mm(np.arange(-600, 600, 7.0))), np.arange(-600, 600, 7.0), atol=1e-9)


def test_a_jitter_without_a_turn_says_so() -> None:
    assert math.isnan(jitter(np.zeros(40), np.random.default_rng(7).normal(size=40), Provenance()).turn_steps)
