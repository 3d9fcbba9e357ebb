import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scanhsi.calibration.geometry import Geometry, fit_geometry, number_grid
from scanhsi.calibration.result import Provenance, load, save
from scanhsi.devices.errors import CalibrationError

STEP_RAD = 2 * math.pi / 19_200
PAPER = Geometry(348.73, 0.0, STEP_RAD, 0.155, 600.0, Provenance())


def test_numbers_of_the_paper():
    assert PAPER.line_pitch_mm(0) == pytest.approx(0.2282, abs=5e-5)
    at = PAPER.linear_range()
    assert at.steps == pytest.approx(600)  # 1200 steps from end to end, a mirror range of pi / 8
    assert at.y_mm == pytest.approx(144.45, abs=0.005)
    assert at.spacing_error_mm == pytest.approx(7.50, abs=0.005)
    assert at.defocus_mm / PAPER.distance_mm == pytest.approx(0.08239, abs=5e-6)
    near = replace(PAPER, distance_mm=225.0).linear_range()
    assert near.y_mm == pytest.approx(93.20, abs=0.005)
    assert near.spacing_error_mm == pytest.approx(4.84, abs=0.005)


@given(
    step=st.floats(-2000, 2000),
    sample=st.floats(0, 1200),
    distance=st.floats(100, 1000),
    tilt=st.floats(-0.2, 0.2),
    direction=st.sampled_from([-1, 1]),
)
@settings(max_examples=200)
def test_there_and_back_is_the_same_place(step, sample, distance, tilt, direction):
    model = replace(PAPER, distance_mm=distance, tilt_rad=tilt, step_rad=direction * STEP_RAD, normal_step=12.3)
    assert model.step_of(model.y_mm(step)) == pytest.approx(step, abs=1e-6)
    assert model.sample_of(model.x_mm(sample, step), step) == pytest.approx(sample, abs=1e-6)
    assert model.y_mm(model.step_of(model.y_mm(step))) == pytest.approx(model.y_mm(step), abs=1e-9, rel=1e-12)


def test_places_on_a_tilted_plane_by_intersecting_rays():
    model = replace(PAPER, tilt_rad=0.1)
    for step in (-700.0, 0.0, 450.0):
        gamma = float(model.gamma_rad(step))
        ray = np.array([-math.sin(gamma), math.cos(gamma)])  # (y, z), z away from the mirror
        plane = np.array([math.cos(0.1), -math.sin(0.1)])  # direction along the plane, through (0, r)
        along, _ = np.linalg.solve(np.stack([plane, -ray], axis=1), [0.0, -348.73])
        assert model.y_mm(step) == pytest.approx(along, abs=1e-9)


def grid(rng, truth: Geometry, lines: int = 21, pitch: float = 6.0, jitter_mm: float = 0.2):
    y = pitch * (np.arange(lines) - lines // 2)
    return truth.step_of(y + rng.normal(0, jitter_mm, lines)), y


def test_the_distance_of_the_paper_from_21_lines_within_half_a_millimetre():
    rng = np.random.default_rng(1)
    fits = []
    for _ in range(60):
        steps, y = grid(rng, PAPER)
        start = replace(PAPER, distance_mm=330.0, normal_step=20.0)
        assert number_grid(steps, replace(start, normal_step=0.0, distance_mm=345.0), 6.0).tolist() == list(
            range(-10, 11)
        )
        fits.append(fit_geometry(steps, y, start, Provenance()))
    distance = np.array([fit.distance_mm for fit in fits])
    normal = np.array([fit.normal_step for fit in fits])
    assert np.std(distance) < 0.5
    assert abs(distance.mean() - 348.73) < 0.2
    assert np.std(normal) < 0.3
    pulls = (distance - 348.73) / [fit.distance_sigma_mm for fit in fits]
    assert 0.8 < np.std(pulls) < 1.35
    assert np.mean([fit.residual_mm for fit in fits]) == pytest.approx(0.2, rel=0.1)


def test_a_line_found_wrong_hardly_matters():
    steps, y = grid(np.random.default_rng(2), PAPER)
    steps[3] += 13  # half a grid cell
    fit = fit_geometry(steps, y, replace(PAPER, distance_mm=340.0), Provenance())
    assert fit.distance_mm == pytest.approx(348.73, abs=1.5)


def test_a_tilt_is_told_from_a_distance():
    truth = replace(PAPER, tilt_rad=math.radians(4), normal_step=7.0)
    steps, y = grid(np.random.default_rng(3), truth, lines=41)
    fit = fit_geometry(steps, y, PAPER, Provenance(), fit_tilt=True)
    assert fit.tilt_rad == pytest.approx(truth.tilt_rad, abs=4 * fit.tilt_sigma_rad)
    assert fit.tilt_sigma_rad < math.radians(0.5)
    assert fit.distance_mm == pytest.approx(348.73, abs=4 * fit.distance_sigma_mm)


def test_a_target_that_lies_anywhere():
    truth = replace(PAPER, normal_step=5.0)
    steps, y = grid(np.random.default_rng(4), truth, lines=41, jitter_mm=0.05)
    fit = fit_geometry(steps, y + 17.0, PAPER, Provenance(), origin_known=False)
    assert fit.distance_mm == pytest.approx(348.73, abs=4 * fit.distance_sigma_mm)
    assert fit.normal_step == pytest.approx(5.0, abs=4 * fit.normal_sigma_steps)


@pytest.mark.parametrize(
    ("steps", "y", "why"),
    [
        (np.arange(4), np.arange(4), "too few"),
        (np.arange(6), np.arange(5), "do not go together"),
        (np.array([0, 1, 2, 3, np.nan]), np.arange(5), "no numbers"),
        (np.zeros(6), np.arange(6), "one place"),
        (np.arange(6) + 4000, np.arange(6), "within 60 degrees"),
    ],
)
def test_what_cannot_be_fitted_is_refused(steps, y, why: str):
    with pytest.raises(CalibrationError, match=why):
        fit_geometry(steps, y, PAPER, Provenance())


def test_a_distance_far_off_cannot_number_the_grid():
    steps, _ = grid(np.random.default_rng(5), PAPER, lines=41)
    with pytest.raises(CalibrationError, match="told apart"):
        number_grid(steps, replace(PAPER, distance_mm=150.0), 6.0)


def test_it_survives_a_file(tmp_path):
    fit = fit_geometry(*grid(np.random.default_rng(6), PAPER), PAPER, Provenance(("grid.zarr",)))
    save(fit, tmp_path / "geometry.nc")
    assert load(Geometry, tmp_path / "geometry.nc").distance_mm == fit.distance_mm
