"""The planner of fields, against the numbers of the paper and its thin-lens table."""

from __future__ import annotations

import math

import pytest

from scanhsi.characterise.planner import FieldPlan, plan_field
from scanhsi.devices.errors import ConfigError

STEP_RAD = 2 * math.pi / 19_200


def plan(height_mm: float, **other: float) -> FieldPlan:
    known = {"distance_mm": 348.73, "sample_pitch_mm": 0.1, "samples": 1200, "step_rad": STEP_RAD, **other}
    return plan_field(height_mm, **known)  # pyright: ignore[reportArgumentType] numbers by name


def test_120_mm_need_the_papers_521_lines() -> None:
    found = plan(119.8)
    assert (found.step, found.lines) == (1, 521)
    assert found.line_pitch_mm == pytest.approx(0.2282, abs=1e-4)
    assert found.linear


def test_square_pixels_take_more_steps_for_coarser_samples() -> None:
    found = plan(100, sample_pitch_mm=0.46)
    assert found.step == 2
    assert abs(found.aspect - 1) < 0.02


@pytest.mark.parametrize(
    ("focal", "f_number", "depth_mm"),
    [(12, 1.3, 23.5), (12, 4, 72.3), (18.2, 4, 30.9), (25, 8, 32.0), (50, 1.3, 1.2), (50, 8, 7.4)],
)
def test_depth_of_field_of_a_thin_lens(focal: float, f_number: float, depth_mm: float) -> None:
    found = plan(100, distance_mm=350, focal_mm=focal, f_number=f_number)
    assert found.depth_of_field_mm == pytest.approx(depth_mm, rel=0.06)


def test_the_curvature_of_the_linear_range_is_eight_percent() -> None:
    found = plan(2 * 348.73 * math.tan(math.pi / 8), focal_mm=50, f_number=1.3)
    assert found.defocus_mm / 348.73 == pytest.approx(0.0824, abs=2e-4)
    assert found.sharp is False


def test_fields_that_cannot_be_are_refused() -> None:
    with pytest.raises(ConfigError, match="degrees"):
        plan(3000)
    with pytest.raises(ConfigError, match="above 0"):
        plan(0)
