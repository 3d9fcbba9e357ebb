"""The two laws: recovered from made-up periods, with intervals that mean something."""

import numpy as np
import pytest

from scanhsi.bench.fits import Estimate, fit_additive, fit_overlapped

EXPOSURES = [0.010, 0.015, 0.020, 0.030, 0.050, 0.100, 0.200]
RNG = np.random.default_rng(7)


def constant(law) -> list[np.ndarray]:
    return [np.full(40, law(exposure)) for exposure in EXPOSURES]


def noisy(law, spread: float, lines: int = 60) -> list[np.ndarray]:
    return [law(exposure) + spread * RNG.standard_normal(lines) for exposure in EXPOSURES]


def test_additive_is_exact_without_noise() -> None:
    law = fit_additive(EXPOSURES, constant(lambda t: t + 0.03333))
    assert law.added.value == pytest.approx(0.03333)
    assert law.added.high - law.added.low < 1e-9
    assert law.floor is None
    assert law.r2 == pytest.approx(1)
    assert law.limit_lps == pytest.approx(30.003)
    assert law.efficiency(0.1) == pytest.approx(0.75, abs=1e-4)


def test_overlapped_is_exact_without_noise() -> None:
    law = fit_overlapped(EXPOSURES, constant(lambda t: max(t + 0.011, 0.0293)))
    assert law.added.value == pytest.approx(0.011)
    assert law.floor is not None
    assert law.floor.value == pytest.approx(0.0293)
    assert law.limit_lps == pytest.approx(1 / 0.0293)
    assert law.r2 == pytest.approx(1)


def test_order_of_the_scans_does_not_matter() -> None:
    periods = constant(lambda t: max(t + 0.011, 0.0293))
    assert fit_overlapped(EXPOSURES[::-1], periods[::-1]) == fit_overlapped(EXPOSURES, periods)


def test_no_floor_where_no_exposure_was_short_enough() -> None:
    law = fit_overlapped(EXPOSURES, constant(lambda t: t + 0.011))
    assert law.floor is None
    assert law.limit_lps is None
    assert law.added.value == pytest.approx(0.011)


def test_a_point_that_lies_off_by_chance_is_no_floor() -> None:
    found = [fit_overlapped(EXPOSURES, noisy(lambda t: t + 0.011, 0.002)).floor for _ in range(40)]
    assert sum(floor is not None for floor in found) <= 4


def test_the_hyperbola_does_not_fit_an_overlapped_instrument() -> None:
    periods = constant(lambda t: max(t, 0.0202))
    assert fit_additive(EXPOSURES, periods).r2 < 0.9 < fit_overlapped(EXPOSURES, periods).r2


def test_intervals_hold_the_truth_about_as_often_as_they_say() -> None:
    held = [0.02 in fit_additive(EXPOSURES, noisy(lambda t: t + 0.02, 0.002)).added for _ in range(60)]
    assert np.mean(held) > 0.8


def test_intervals_of_dependent_lines_are_wider() -> None:
    steps = RNG.standard_normal((7, 200))
    walks = np.array([np.convolve(row, np.ones(8) / 8, "same") for row in steps]) * 0.001
    shuffled = RNG.permuted(walks, axis=1)

    def width(noise: np.ndarray) -> float:
        added = fit_additive(EXPOSURES, [t + 0.02 + row for t, row in zip(EXPOSURES, noise, strict=True)]).added
        return added.high - added.low

    assert width(walks) > 1.5 * width(shuffled)


def test_the_same_data_give_the_same_intervals() -> None:
    periods = noisy(lambda t: max(t + 0.01, 0.02), 0.001)
    assert fit_overlapped(EXPOSURES, periods) == fit_overlapped(EXPOSURES, periods)


def test_one_scan_of_two_lines_is_enough() -> None:
    law = fit_additive([0.01], [np.array([0.03])])
    assert law.added.value == pytest.approx(0.02)
    assert np.isnan(law.r2)


def test_estimates_read_as_milliseconds() -> None:
    assert str(Estimate(0.0333333, 0.0332, 0.0335)) == "33.33 ± 0.15"
    assert str(Estimate(-1e-9, -1e-6, 1e-6)) == "0.00 ± 0.00"
