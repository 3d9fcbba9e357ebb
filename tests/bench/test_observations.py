"""The journal: raw stamps in, the same stamps out, whatever else is in the file."""

import json
from pathlib import Path

import numpy as np
import pytest

from scanhsi.bench.observations import Journal, Observation, observation, read_sessions
from scanhsi.cube.records import NOT_STAMPED, STAGES, LineRecords
from scanhsi.devices.errors import CubeError


def seen(lines: int = 4, origin: int = 10**15) -> Observation:
    records = LineRecords(lines)
    for number, stage in enumerate(STAGES):
        if stage != "first_byte":
            records.stamps[stage][:] = origin + 1_000_000 * np.arange(lines) + number
    records.stamps["commanded"][0] = records.stamps["started"][0] = NOT_STAMPED
    records.mark_missing(2, "3 packets missing")
    records.stamps["copied"][2] = NOT_STAMPED
    return observation(records, mode="stepped", scenario="full", pixel_format="Mono8", exposure_s=0.02, seed=3)


def test_stamps_come_back_as_they_were(tmp_path: Path) -> None:
    path, wrote = tmp_path / "o.jsonl", seen()
    journal = Journal(path, "one")
    journal.begin({"virtual_time": True})
    journal.add(wrote)
    (session,) = read_sessions(path)
    assert session.facts["virtual_time"] is True
    (read,) = session.observations
    assert (read.mode, read.seed, read.missing) == ("stepped", 3, {2: "3 packets missing"})
    for stage in STAGES:
        np.testing.assert_array_equal(read.stamps[stage], wrote.stamps[stage])


def test_stamps_count_from_the_first() -> None:
    stamps = seen().stamps
    assert stamps["commanded"].tolist() == [NOT_STAMPED, 10**6 - 2, 2 * 10**6 - 2, 3 * 10**6 - 2]
    assert stamps["moved"][0] == 0


def test_a_lost_line_makes_one_long_period() -> None:
    assert seen().periods_s.tolist() == pytest.approx([0.001, 0.002])


def test_sessions_are_appended(tmp_path: Path) -> None:
    path = tmp_path / "o.jsonl"
    for name in ("one", "two"):
        Journal(path, name).begin({})
        Journal(path, name).add(seen())
    first, second = read_sessions(path)
    assert len(first.observations) == len(second.observations) == 1


def test_a_last_line_that_was_cut_off_costs_only_itself(tmp_path: Path) -> None:
    path = tmp_path / "o.jsonl"
    Journal(path, "one").begin({})
    Journal(path, "one").add(seen())
    path.write_text(path.read_text() + path.read_text()[:500].splitlines()[-1][:40])
    assert len(read_sessions(path)[0].observations) == 1


def test_nonsense_in_the_middle_is_told(tmp_path: Path) -> None:
    path = tmp_path / "o.jsonl"
    path.write_text('nonsense\n{"record": "session"}\n')
    with pytest.raises(CubeError, match="line 1 is not JSON"):
        read_sessions(path)


def test_a_newer_schema_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "o.jsonl"
    path.write_text(json.dumps({"record": "session", "session": "one", "schema": 99}) + "\n")
    with pytest.raises(CubeError, match="schema 99"):
        read_sessions(path)


def test_no_file(tmp_path: Path) -> None:
    with pytest.raises(CubeError, match="cannot read"):
        read_sessions(tmp_path / "none.jsonl")
    with pytest.raises(CubeError, match="cannot write"):
        Journal(tmp_path / "nowhere" / "o.jsonl", "one").begin({})
