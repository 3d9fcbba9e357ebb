"""Where the mirror looks, other than where it was sent."""

from __future__ import annotations

import numpy as np
import pytest

from scanhsi_sim import ActuatorOptions, CameraOptions, truth
from scanhsi_sim.bench import Mirror
from scanhsi_sim.effects import MirrorOptions
from scanhsi_sim.mirror import error_steps, follow


def stops(errors: MirrorOptions, steps: list[int], seed: int = 5) -> list[float]:
    """Where the mirror looks after each of some motions."""
    mirror = Mirror(steps[0], errors, seed)
    seen: list[float] = []
    for line, step in enumerate(steps):
        mirror.move(line * 100, line * 100 + 50, step)
        low, high = mirror.view(line * 100 + 60, line * 100 + 90)
        assert low == high
        seen.append(low)
    return seen


def test_without_errors_it_looks_where_it_was_sent() -> None:
    steps = list(range(-20, 20, 3))
    assert stops(MirrorOptions(), steps) == steps


def test_jitter_has_its_size_is_not_repeated_and_is_reproducible() -> None:
    errors = MirrorOptions(jitter_steps=0.876)
    steps = [100, 101] * 600
    seen = np.array(stops(errors, steps))
    off = seen - steps
    assert off.std() == pytest.approx(0.876, rel=0.06)
    assert abs(off.mean()) < 0.08
    assert abs(np.corrcoef(off[:-1], off[1:])[0, 1]) < 0.08
    assert stops(errors, steps) == seen.tolist()
    assert stops(errors, steps, seed=6) != seen.tolist()


def test_jitter_depends_on_the_motions_alone_however_often_somebody_looks() -> None:
    errors = MirrorOptions(jitter_steps=0.5)
    once, often = Mirror(0, errors, 1), Mirror(0, errors, 1)
    for mirror, looks in ((once, 1), (often, 5)):
        mirror.move(0, 10, 3)
        for _ in range(looks):
            mirror.view(20, 30)
        mirror.move(40, 50, 4)
    assert once.view(60, 70) == often.view(60, 70)
    assert once.view(60, 61) == once.view(80, 95)


def test_a_long_life_forgets_corners_and_not_their_count() -> None:
    """The jitter of motion 900 is that of motion 900, whatever the mirror has forgotten."""
    errors = MirrorOptions(jitter_steps=0.5)
    steps = list(range(2000))
    seen = stops(errors, steps)
    again = [step + error_steps(errors, step, line + 1, 5) for line, step in enumerate(steps)]
    np.testing.assert_allclose(seen, again)


def test_the_periodic_error_repeats_every_four_full_steps() -> None:
    errors = MirrorOptions(periodic_steps=0.4, microsteps=16)
    off = np.array(stops(errors, list(range(256)))) - np.arange(256)
    np.testing.assert_allclose(off, 0.4 * np.sin(2 * np.pi * np.arange(256) / 64), atol=1e-9)


def test_a_misaligned_shaft_is_a_cosine() -> None:
    errors = MirrorOptions(misalignment_steps=1.5, misalignment_period_steps=320, misalignment_phase_deg=90)
    off = np.array(stops(errors, list(range(0, 640, 16)))) - np.arange(0, 640, 16)
    np.testing.assert_allclose(off, -1.5 * np.sin(2 * np.pi * np.arange(0, 640, 16) / 320), atol=1e-9)


def test_backlash_is_taken_up_before_the_mirror_follows() -> None:
    errors = MirrorOptions(backlash_steps=2.5)
    assert stops(errors, [0, 10, 9, 8, 7, 6, 7, 8, 9, 10]) == [0, 10, 10, 10, 9.5, 8.5, 8.5, 8.5, 9, 10]
    assert follow(10, 11, 2.5) == 11
    assert follow(10, 4, 2.5) == 6.5


def test_a_sweep_downwards_lags_by_the_play_while_it_moves() -> None:
    mirror = Mirror(0, MirrorOptions(backlash_steps=4), 0)
    mirror.move(0, 1_000_000, -100)
    assert mirror.view(500_000, 510_000) == pytest.approx((-47, -46), abs=0.1)  # on the way the motor is at -50 to -51
    assert mirror.view(0, 30_000) == pytest.approx((0, 0))  # three steps: the play takes them all
    assert mirror.view(1_000_000, 1_100_000) == (-96, -96)


def test_a_halt_leaves_it_where_it_hangs() -> None:
    mirror = Mirror(0, MirrorOptions(backlash_steps=4), 0)
    mirror.move(0, 1_000_000, -100)
    assert mirror.halt(500_000) == -50
    assert mirror.view(600_000, 700_000) == (-46, -46)


def test_truth_tells_the_jitter_in_mm() -> None:
    real = truth(
        CameraOptions(distance_mm=348.73, bands=4, samples=4), ActuatorOptions(mirror=MirrorOptions(jitter_steps=0.876))
    )
    assert real.jitter_mm == pytest.approx(0.2, abs=1e-3)  # paper.md, section 9.4
    assert real.mirror.backlash_steps == 0
