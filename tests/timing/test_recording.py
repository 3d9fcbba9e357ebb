"""From stamps to a delay profile."""

import numpy as np
import pytest
from numpy.typing import NDArray

from scanhsi.cube.records import NOT_STAMPED, STAGES
from scanhsi.devices.errors import ConfigError
from scanhsi.timing.delays import DelayProfile
from scanhsi.timing.distributions import Constant, Quantile
from scanhsi.timing.recording import Recording, dependence, measured_ns, profile_of, table


def recording(*, steps: int = 2, mode: str = "stepped", pixel_format: str = "Mono8", **stamps: list[int]) -> Recording:
    lines = len(next(iter(stamps.values())))
    columns = {stage: np.full(lines, NOT_STAMPED, np.int64) for stage in STAGES}
    columns |= {stage: np.array(values, np.int64) for stage, values in stamps.items()}
    return Recording(columns, 100, pixel_format, steps, mode)


STEPPED = recording(
    commanded=[NOT_STAMPED, 110, 300],
    moved=[NOT_STAMPED, 160, 370],
    trigger=[0, 160, 370],
    exposure_start=[3, 165, 371],
    exposure_end=[103, 265, 471],
    first_byte=[105, 400, 700],
    received=[400, 700, 720],
    copied=[500, 730, 770],
)


def test_each_stage_from_when_line_and_stage_were_ready() -> None:
    found = {stream: delays.tolist() for stream, delays in measured_ns(STEPPED).items()}
    assert found == {
        "T_trig": [3, 5, 1],
        "T_ev": [7, 35, -1],  # commanded 110 and 300, after nominal ends 103 and 265
        "t1": [2, -1, -1],  # of the others the link was busy
        "T_rx": [295, 300, 20],
        "T_mcpy": [100, 30, 40],  # the last waited for the copier until 730
        "T_act": [-1, 50, 70],
        "T_rand": [-1, 0, 0],
    }


def test_a_trigger_waits_for_the_mirror_and_a_buffer_and_then_for_the_host() -> None:
    """Two line buffers: line 2 is ready when line 0 is stored, at 130, and line 3 when the mirror is there."""
    lines = recording(
        moved=[NOT_STAMPED, 50, 100, 150],
        trigger=[0, 52, 134, 153],
        exposure_start=[1, 53, 135, 154],
        copied=[20, 70, 140, 170],
        stored=[130, 131, 152, 190],
    )
    assert measured_ns(lines)["T_trig"].tolist() == [1, 3, 5, 4]


def test_a_sequential_scan_tells_what_the_host_takes_from_line_to_line() -> None:
    found = measured_ns(recording(mode="sequential", commanded=[NOT_STAMPED, 107, 203], copied=[100, 200, 300]))
    assert found["T_rand"].tolist() == [-1, 7, 3]


def test_a_transfer_without_first_byte_counts_from_the_exposure_less_the_queue() -> None:
    found = measured_ns(recording(exposure_end=[100, 200, 300], received=[250, 420, 500]))
    assert found["T_rx"].tolist() == [150, 170, 80]
    assert "t1" not in found


def test_lines_without_stamps_are_left_out() -> None:
    found = measured_ns(recording(commanded=[0, 10, 20], moved=[4, NOT_STAMPED, 26]))
    assert found["T_act"].tolist() == [4, -1, 6]


def heavy(lines: int) -> NDArray[np.int64]:
    return np.rint(np.exp(np.random.default_rng(3).normal(14, 0.9, lines))).astype(np.int64)


@pytest.mark.parametrize("lines", [2, 60, 5000])
def test_table_keeps_mean_least_and_tail(lines: int) -> None:
    delays = heavy(lines)
    kept = table(delays)
    assert isinstance(kept, Quantile)
    assert kept.mean_s == pytest.approx(delays.mean() * 1e-9)
    assert (kept.knots[0][1], kept.knots[-1][1]) == (delays.min(), delays.max())
    drawn = kept.sample_s(np.linspace(0, 1, 100_001)[:, None])
    wanted = np.quantile(delays, (0.05, 0.5, 0.95, 0.99), method="hazen") * 1e-9
    assert np.quantile(drawn, (0.05, 0.5, 0.95, 0.99)) == pytest.approx(wanted, rel=0.02)


def test_equal_delays_are_a_constant() -> None:
    assert table(np.full(9, 7)) == Constant(kind="constant", unit="ns", value=7)


def test_dependence_of_independent_and_of_bursty_delays() -> None:
    rng = np.random.default_rng(5)
    noise = rng.normal(size=4000)
    bursty = np.zeros(4000)
    for line in range(1, 4000):
        bursty[line] = 0.8 * bursty[line - 1] + noise[line]
    free, bound = (dependence([np.rint(1e6 * values).astype(np.int64)]) for values in (noise, bursty))
    assert abs(free.acf[1]) < 0.05
    assert (free.n, free.length) == (4000, 1)
    assert [bound.acf[lag] for lag in (1, 2, 5)] == pytest.approx([0.8, 0.64, 0.33], abs=0.06)
    assert bound.length == pytest.approx(9, rel=0.35)  # (1 + 0.8) / (1 - 0.8)


def record(*scans: Recording) -> DelayProfile:
    return profile_of(scans, name="mine", source="a test", mark="measured")


def test_profile_of_two_formats() -> None:
    profile = record(STEPPED, recording(exposure_end=[0, 900], received=[500, 1400], pixel_format="Mono12"))
    assert profile.mean_s("T_rx", pixel_format="Mono8") == pytest.approx(205e-9)
    assert profile.mean_s("T_rx", pixel_format="Mono12") == pytest.approx(500e-9)
    assert profile.mean_s("T_act") == pytest.approx(60e-9)
    assert profile.mean_s("T_rand") == profile.mean_s("settle") == profile.mean_s("T_api") == 0
    assert "not separable" in profile.streams["settle"].note
    assert "motor steps a line: 2" in profile.streams["T_act"].note


def test_time_per_step_from_moves_of_different_length() -> None:
    """Half a microsecond a step, whatever else a move takes; one length of moves tells nothing of it."""
    rest = heavy(60) // 1000
    scans = [
        recording(commanded=[0] * 60, moved=(rest + 500 * abs(steps)).tolist(), steps=steps) for steps in (1, -4, 16)
    ]
    model = record(*scans).streams["T_act"]
    assert model.per_step == Constant(kind="constant", unit="ns", value=500)
    assert model.delay is not None
    assert model.delay.mean_s == pytest.approx(rest.mean() * 1e-9)
    assert "motor steps a line: 1, 4, 16; 0.0005 ms a step" in model.note
    assert record(scans[1]).streams["T_act"].per_step is None


def test_storing_is_shared_by_the_lines_of_a_commit() -> None:
    """Three lines are committed at 500, as soon as the last is copied, and two at 900, when that commit is over."""
    lines = recording(copied=[100, 200, 320, 400, 480], stored=[500, 500, 500, 900, 900])
    assert measured_ns(lines)["T_store"].tolist() == [60, 60, 60, 200, 200]
    assert "T_store" not in measured_ns(recording(mode="sequential", copied=[100], stored=[500]))


def test_lines_are_kept_whole() -> None:
    (scan,) = record(STEPPED).scans
    assert (scan.lines, scan.pixel_format, scan.steps, scan.exposure_ns) == (3, "Mono8", 2, 100)
    assert scan.delays_ns["T_act"] == (None, 50, 70)
    assert scan.delays_ns["T_mcpy"] == (100, 30, 40)


def test_nothing_stamped_is_refused() -> None:
    with pytest.raises(ConfigError, match="no line"):
        record(recording(commanded=[0, 10]))
