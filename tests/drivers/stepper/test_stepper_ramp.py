"""Motion times against the table of the reference (K'_n / sqrt(a) + 0.02 ms, trapezoids, start speeds)."""

import pytest

from scanhsi_stepper.ramp import Profile, move_time_s, run_up_time_s

FROM_REST = Profile(4000, 20_000)


@pytest.mark.parametrize(("steps", "k"), [(1, 0), (2, 0.956), (4, 2.486), (8, 4.329), (16, 6.788), (64, 14.92)])
def test_triangles_follow_the_table(steps: int, k: float) -> None:
    assert move_time_s(steps, FROM_REST) == pytest.approx(k / 20_000**0.5 + 20e-6, rel=1e-3)
    assert move_time_s(-steps, FROM_REST) == move_time_s(steps, FROM_REST)


@pytest.mark.parametrize(
    ("steps", "start_speed", "ms"), [(8, 2000, 3.53), (64, 2000, 29.5), (8, 4000, 1.80), (64, 4000, 15.8)]
)
def test_start_speeds(steps: int, start_speed: int, ms: float) -> None:
    assert move_time_s(steps, Profile(4000, 20_000, start_speed)) == pytest.approx(ms * 1e-3, rel=0.03)


def test_trapezoid_as_measured() -> None:
    assert move_time_s(4000, FROM_REST) == pytest.approx(1.193, abs=0.001)
    assert move_time_s(0, FROM_REST) == 0


def test_very_slow_acceleration_uses_the_closed_form() -> None:
    slow = Profile(12_000, 10)
    assert slow.ramp_steps > 1_000_000
    assert move_time_s(10_000, slow) == pytest.approx(2 * (10_000 / 10) ** 0.5, rel=0.01)


def test_run_up_reaches_constant_speed() -> None:
    steps = FROM_REST.ramp_steps + 4
    assert run_up_time_s(steps + 4000, FROM_REST) - run_up_time_s(steps, FROM_REST) == pytest.approx(1.0)
