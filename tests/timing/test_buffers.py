"""How close to the mean of a random stage a period may come."""

import numpy as np
import pytest

from scanhsi.timing.buffers import levelled_period_s, long_run_spread_s


@pytest.mark.parametrize("correlation", [0.0, 0.8])
def test_a_queue_of_some_frames_levels_a_random_stage_out(correlation: float) -> None:
    """In half a million lines nothing finds the queue full, and it was needed: a third of the margin would not do."""
    rng = np.random.default_rng(7)
    lines, mean_s, frames = 500_000, 0.020, 3
    noise = rng.normal(0, 1, lines)
    for line in range(1, lines):  # AR(1) of unit variance
        noise[line] = correlation * noise[line - 1] + (1 - correlation**2) ** 0.5 * noise[line]
    duration_ns = np.round((mean_s + 2e-3 * noise) * 1e9).astype(np.int64)
    spread_s = long_run_spread_s(duration_ns)
    period_s = levelled_period_s(mean_s, spread_s, frames)
    assert _most_waiting_s(duration_ns, period_s) < frames * mean_s
    assert _most_waiting_s(duration_ns, mean_s + (period_s - mean_s) / 3) > frames * mean_s


def _most_waiting_s(duration_ns: np.ndarray, period_s: float) -> float:
    behind = np.concatenate(([0.0], np.cumsum(duration_ns * 1e-9 - period_s)))
    return float((behind - np.minimum.accumulate(behind)).max())


def test_neighbours_with_something_in_common_spread_further() -> None:
    independent = np.random.default_rng(1).integers(0, 1000, 64_000)
    together = np.repeat(independent[:16_000], 4)
    assert long_run_spread_s(together) == pytest.approx(2 * long_run_spread_s(independent), rel=0.1)
    assert long_run_spread_s(independent) == pytest.approx(float(independent.std()) * 1e-9, rel=0.1)


def test_a_stage_without_spread_needs_no_margin() -> None:
    assert levelled_period_s(0.02, 0.0, 8) == 0.02
