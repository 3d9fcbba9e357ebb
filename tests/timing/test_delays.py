"""Delay profiles and the streams drawn from them."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import scanhsi_sim
from scanhsi.devices.errors import ConfigError
from scanhsi.timing.delays import DelayProfile, DelayStreams, Stream, load_profile

PROFILES = Path(scanhsi_sim.__file__).parent / "profiles"
OVERHEAD: tuple[Stream, ...] = ("T_rx", "T_api", "T_mcpy", "T_act", "T_rand")


@pytest.fixture
def sensors2019() -> DelayProfile:
    return load_profile(PROFILES / "sensors2019.json")


@pytest.mark.parametrize(("pixel_format", "total_ms"), [("Mono8", 33.33), ("Mono12Packed", 43.52), ("Mono12", 54.35)])
def test_overhead_of_a_line_is_the_papers(sensors2019: DelayProfile, pixel_format: str, total_ms: float) -> None:
    """Efficiency 0.75 at 100 ms and 8 bit means 33.33 ms of overhead: eqs 1 and 3 (paper, section 3.6)."""
    total = sum(sensors2019.mean_s(stream, pixel_format=pixel_format, steps=1) for stream in OVERHEAD)
    assert total * 1e3 == pytest.approx(total_ms, abs=0.001)


def test_efficiency_by_eq_3(sensors2019: DelayProfile) -> None:
    def efficiency(exposure_ms: float, pixel_format: str, steps: int = 1) -> float:
        means = (sensors2019.mean_s(stream, pixel_format=pixel_format, steps=steps) for stream in OVERHEAD)
        return exposure_ms / (exposure_ms + sum(means) * 1e3)

    assert [round(efficiency(ms, "Mono8"), 3) for ms in (100, 200, 300)] == [0.750, 0.857, 0.900]
    assert [round(efficiency(ms, "Mono12Packed"), 3) for ms in (100, 200, 300)] == [0.697, 0.821, 0.873]
    assert [round(efficiency(100, "Mono8", s), 3) for s in (1, 2, 4, 8, 16, 32)] == [
        0.75,
        0.749,
        0.746,
        0.74,
        0.73,
        0.709,
    ]


def test_drawn_overhead_has_the_spread_of_the_construction(sensors2019: DelayProfile) -> None:
    streams = DelayStreams(sensors2019, seed=3)
    total = sum(streams.array_ns(stream, 100_000, pixel_format="Mono8", steps=1) for stream in OVERHEAD) * 1e-6
    assert np.mean(total) == pytest.approx(33.33, abs=0.03)
    assert np.std(total) == pytest.approx(1.61, abs=0.06)
    assert np.percentile(total, [50, 95, 99]) == pytest.approx([33.0, 36.0, 38.8], abs=0.2)


def test_every_number_says_that_it_is_not_measured(sensors2019: DelayProfile) -> None:
    marks = {sensors2019.mark, *(stream.mark for stream in sensors2019.streams.values())}
    assert marks == {"derived-from-text, not measured"}


def test_the_same_digits_on_every_machine(sensors2019: DelayProfile) -> None:
    streams = DelayStreams(sensors2019, seed=2019)
    drawn = {
        stream: [
            streams.delay_ns(stream, line, pixel_format="Mono12Packed", steps=1) for line in (0, 1, 1023, 1024, 99_999)
        ]
        for stream in sensors2019.streams
    }
    assert drawn == GOLDEN


def test_a_draw_depends_on_its_line_only(sensors2019: DelayProfile) -> None:
    forwards, backwards = DelayStreams(sensors2019, seed=5), DelayStreams(sensors2019, seed=5)
    lines = [*range(0, 12_000, 997)]
    ahead = [forwards.delay_ns("T_act", line) for line in lines]
    assert [backwards.delay_ns("T_act", line) for line in reversed(lines)] == ahead[::-1]
    assert forwards.array_ns("T_act", 12_000)[lines].tolist() == ahead
    assert len(set(ahead)) == len(ahead)


def test_streams_and_seeds_are_independent(sensors2019: DelayProfile) -> None:
    one, other = DelayStreams(sensors2019, seed=1), DelayStreams(sensors2019, seed=2)
    n = 20_000
    columns = [
        one.array_ns("T_api", n),
        one.array_ns("T_act", n),
        one.array_ns("T_rand", n),
        other.array_ns("T_api", n),
        np.roll(one.array_ns("T_api", n), 1),
    ]
    correlation = np.corrcoef(columns) - np.eye(len(columns))
    assert np.abs(correlation).max() < 0.03


def test_pixel_formats_share_their_random_numbers(sensors2019: DelayProfile) -> None:
    """Formats differ by what they cost, not by luck: the slow lines are the same lines."""
    streams = DelayStreams(sensors2019, seed=1)
    eight, twelve = (streams.array_ns("T_mcpy", 500, pixel_format=kind) for kind in ("Mono8", "Mono12"))
    np.testing.assert_allclose(twelve, 2 * eight, atol=2)


def test_each_step_of_a_move_costs(sensors2019: DelayProfile) -> None:
    streams = DelayStreams(sensors2019, seed=1)
    assert streams.delay_ns("T_act", 7, steps=4) - streams.delay_ns("T_act", 7) == 1_000_000
    assert streams.delay_ns("T_act", 7, steps=-4) == streams.delay_ns("T_act", 7, steps=4)
    assert sensors2019.mean_s("T_act", steps=1) == pytest.approx(10.69e-3)


def test_a_stream_that_a_profile_lacks_costs_nothing() -> None:
    ideal = load_profile(PROFILES / "ideal.json")
    assert DelayStreams(ideal, 0).delay_ns("T_rx", 3, pixel_format="Mono8", steps=5) == 0
    assert ideal.mean_s("T_act", steps=9) == 0


def test_memory_stays_bounded(sensors2019: DelayProfile) -> None:
    streams = DelayStreams(sensors2019, seed=1)
    for line in range(0, 1_000_000, 1024):
        streams.delay_ns("T_act", line)
    assert sum(len(blocks) for blocks in streams._blocks.values()) <= 4


def test_a_format_without_delays_is_named(sensors2019: DelayProfile) -> None:
    with pytest.raises(
        ConfigError, match="sensors2019: T_rx has no delay for Mono16; it has Mono8, Mono12Packed, Mono12"
    ):
        DelayStreams(sensors2019, seed=1).delay_ns("T_rx", 0, pixel_format="Mono16")


@pytest.mark.parametrize("seed", [-1, 2**64])
def test_a_seed_has_64_bits(sensors2019: DelayProfile, seed: int) -> None:
    with pytest.raises(ValueError, match="seed"):
        DelayStreams(sensors2019, seed)


def _without(key: str) -> Any:
    return lambda profile: profile.pop(key)


def _set(*path: Any) -> Any:
    *keys, last, value = path

    def change(profile: Any) -> None:
        for key in keys:
            profile = profile[key]
        profile[last] = value

    return change


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (_without("mark"), "mark: Field required"),
        (_set("schema", 2), "schema: Input should be 1"),
        (_set("streams", "T_atc", {"note": "", "mark": ""}), r"streams\.T_atc"),
        (
            _set("streams", "T_api", "delay", "cv", -1),
            r"streams\.T_api\.delay\.lognormal\.cv: Input should be greater than 0",
        ),
        (
            _set("streams", "T_api", "by_format", {"Mono8": {"kind": "constant", "unit": "ms", "value": 1}}),
            "either delay or by_format",
        ),
        (_without("streams"), "streams: Field required"),
    ],
)
def test_a_bad_profile_is_refused_by_file_and_key(tmp_path: Path, change: Any, complaint: str) -> None:
    profile = json.loads((PROFILES / "sensors2019.json").read_text())
    change(profile)
    path = tmp_path / "mine.json"
    path.write_text(json.dumps(profile))
    with pytest.raises(ConfigError, match=complaint) as refused:
        load_profile(path)
    assert str(path) in str(refused.value)


def test_no_file_and_no_json_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none\.json: cannot read the delay profile: No such file"):
        load_profile(tmp_path / "none.json")
    (tmp_path / "torn.json").write_text('{"schema": 1, ')
    with pytest.raises(ConfigError, match=r"torn\.json is not a delay profile:\n.*file: Invalid JSON.*line 1"):
        load_profile(tmp_path / "torn.json")


GOLDEN = {
    "T_rx": [27218277, 27336350, 27272980, 27216914, 27303490],
    "T_api": [1951307, 2008827, 2107055, 1781923, 1966770],
    "T_mcpy": [2853101, 2953500, 3476620, 3583106, 3429119],
    "T_act": [11257141, 10471263, 9723734, 10225370, 11795108],
    "T_cmd": [2761066, 1864061, 2669964, 2474258, 2327275],
    "T_rand": [92207, 11036, 355792, 123179, 142513],
    "T_rd": [20200000, 20200000, 20200000, 20200000, 20200000],
}
