"""Whether two profiles differ."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from scanhsi.devices import PixelFormat
from scanhsi.devices.errors import ConfigError
from scanhsi.timing.closed_forms import Layout
from scanhsi.timing.comparison import compare_replays, compare_streams, replay_plan
from scanhsi.timing.delays import DelayProfile
from scanhsi.timing.drops import lost
from scanhsi.timing.two_sample import two_sample
from support.recorded import MS, Ns, bursty_store, recorded, storing


def noise(seed: int, lines: int = 400, rho: float = 0.0) -> Ns:
    """Around 10 ms, dependent on the line before."""
    free = np.random.default_rng(seed).normal(size=lines)
    bound = free.copy()
    for line in range(1, lines):
        bound[line] = rho * bound[line - 1] + np.sqrt(1 - rho**2) * free[line]
    return np.rint(10 * MS + MS * bound).astype(np.int64)


def profile(seed: int, lines: int = 400, rho: float = 0.0, later: int = 0) -> DelayProfile:
    return recorded({"T_act": noise(seed, lines, rho) + later, "T_rx": noise(seed + 1000, lines, rho)})


def test_the_two_sample_test_keeps_its_level_and_sees_tails() -> None:
    generator = np.random.default_rng(0)
    p = [two_sample(generator.normal(size=60), generator.normal(size=40)).p for _ in range(200)]
    assert np.mean(np.array(p) < 0.05) == pytest.approx(0.05, abs=0.045)
    same, wider = generator.normal(size=200), generator.normal(0, 1.7, 200)
    assert two_sample(same, wider).p < 0.01
    assert two_sample(np.ones(9), np.ones(5)).p == 1
    ties = two_sample(np.array([0, 0, 1, 1] * 20), np.array([0, 0, 0, 1] * 20))
    assert ties.distance == pytest.approx(0.25)
    assert 0.001 < ties.p < 0.05


def test_p_is_the_part_of_shuffles_with_a_larger_statistic() -> None:
    """All 70 ways to divide eight values in two, with the statistic as Pettitt (1976) writes it."""
    values = np.array([3.0, 1.0, 4.0, 1.5, 9.0, 2.6, 5.0, 3.5])

    def statistic(chosen: tuple[int, ...]) -> float:
        order = np.argsort(values)
        passed = np.cumsum(np.isin(order, chosen))[:-1]
        i = np.arange(1, 8)
        return float(np.sum((passed * 8 - 4 * i) ** 2 / (i * (8 - i))))

    every = [statistic(chosen) for chosen in combinations(range(8), 4)]
    exact = float(np.mean(np.array(every) >= statistic((0, 1, 2, 3)) - 1e-9))
    found = two_sample(values[:4], values[4:])
    assert found.p == pytest.approx(exact, abs=0.035)
    assert found.distance == pytest.approx(0.5)


def test_dependent_delays_of_one_kind_are_not_told_apart() -> None:
    """Without thinning, autocorrelation of 0.8 would make one pair in two differ."""
    differ = [
        each.verdict
        for seed in range(0, 40, 2)
        for each in compare_streams(profile(seed, rho=0.8), profile(seed + 1, rho=0.8))
        if each.stream == "T_act"
    ]
    assert differ.count("differ") <= 3
    (act, *_) = (each for each in compare_streams(profile(1, rho=0.8), profile(2, rho=0.8)) if each.stream == "T_act")
    assert act.lines == (400, 400)
    assert all(20 < n < 120 for n in act.independent)


def test_a_slower_mirror_is_seen_and_matters() -> None:
    before, after = profile(1), profile(2, later=MS)
    found = {each.stream: each for each in compare_streams(before, after)}
    assert found["T_act"].verdict == "differ"
    assert found["T_act"].median_s[1] - found["T_act"].median_s[0] == pytest.approx(1e-3, abs=0.3e-3)
    assert found["T_rx"].verdict == "no difference seen"
    replays = {each.name: each for each in compare_replays(before, after, replay_plan(before, after))}
    stepped = replays["period stepped"]
    assert stepped.verdict == "differ"
    assert stepped.low < 1e-3 < stepped.high
    assert replays["period continuous"].verdict == replays["lines lost"].verdict == "no difference seen"


def test_a_profile_does_not_differ_from_itself() -> None:
    mine = profile(3, rho=0.5)
    assert {each.verdict for each in compare_streams(mine, mine)} == {"no difference seen"}
    assert {each.verdict for each in compare_replays(mine, mine, replay_plan(mine, mine))} == {"no difference seen"}


def test_few_lines_tell_nothing() -> None:
    found = compare_streams(profile(1, lines=8), profile(2, lines=400, later=9 * MS))
    assert {each.verdict for each in found} == {"too few lines"}


def test_a_bursty_writer_is_told_by_the_lines_lost() -> None:
    store = bursty_store(4000, 1)
    steady = np.random.default_rng(1).permutation(store)
    profiles = [recorded({"T_rx": np.full(4000, 9 * MS), "T_store": each}) for each in (steady, store)]
    plan = replay_plan(profiles[0], profiles[1], period_s=20.5e-3, layout=Layout(line_buffers=4))
    assert (plan.lines, plan.exposure_s, plan.pixel_format) == (1000, 0.01, PixelFormat.MONO8)
    gone = compare_replays(profiles[0], profiles[1], plan)[-1]
    assert gone.name == "lines lost"
    assert gone.means[1] > 5 * gone.means[0]


def test_profiles_without_recorded_lines_are_compared_by_replay_only() -> None:
    bare = profile(1).model_copy(update={"scans": ()})
    assert compare_streams(bare, profile(2)) == []
    assert compare_replays(bare, profile(2), replay_plan(bare, profile(2)))[1].means == pytest.approx(
        (20e-3, 20e-3), rel=0.05
    )


def test_no_common_format() -> None:
    other = recorded({"T_rx": noise(1)}, pixel_format="Mono12")
    with pytest.raises(ConfigError, match="no pixel format in common; they have none"):
        replay_plan(profile(1), other)


def test_a_sweep_with_room_loses_nothing_and_one_without_all_it_must() -> None:
    """Storing of 41 ms in a sweep of 20 ms: with two buffers every second line is lost in the long run."""
    slow = np.full(400, 41 * MS)
    assert lost(storing(slow, 2), 20 * MS).mean() == pytest.approx(0.5, abs=0.2)
    assert not lost(storing(slow // 3, 2), 20 * MS).any()
