"""``scanhsi bench processing``: it measures what it says; how fast this computer is, is not tested."""

import json

import numpy as np
import pytest

from scanhsi.bench.processing.report import markdown
from scanhsi.bench.processing.rows import IN_MEMORY, LIVE, ON_DISK, ROWS, Given, clean
from scanhsi.bench.processing.session import OBSERVATIONS, Effort, prepare, run_session
from scanhsi.bench.processing.work import Size, chain, pipeline
from scanhsi.bench.storage.work import synthetic_lines
from scanhsi.processing.kernel import Kernel

LITTLE = Size(20, 40, 60)


def test_every_row_is_of_one_part():
    assert sorted([*IN_MEMORY, *ON_DISK, *LIVE]) == sorted(ROWS)


def test_what_is_measured_in_one_pass_is_what_the_steps_make():
    frames = synthetic_lines(LITTLE.bands, LITTLE.samples, 4).transpose(1, 0, 2)
    run = pipeline(LITTLE)
    assert [type(function) for function in run.functions] == [Kernel]
    values = frames
    for _, function in run.bound:
        values = function(values)
    np.testing.assert_allclose(run(frames), values, rtol=1e-4, atol=1e-5)
    assert len(chain(LITTLE)) == 5


def test_rows_from_disk_to_disk_take_time_and_leave_nothing(tmp_path):
    prepare(Effort(parts=["disk"], size=LITTLE), tmp_path)
    there = sorted(tmp_path.iterdir())
    for name in ON_DISK:
        assert ROWS[name](Given(LITTLE, np.zeros(0, np.uint16), tmp_path))["wall_s"] > 0
        clean(tmp_path)
        assert sorted(tmp_path.iterdir()) == there


@pytest.mark.soak
def test_a_session_appends_what_was_seen_and_cleans_up(tmp_path):
    effort = Effort(parts=["disk"], size=LITTLE, repetitions=1)
    records = run_session(effort, tmp_path)
    seen = {record["row"]: record for record in records[1:]}
    assert list(seen) == list(ON_DISK)
    assert not [record for record in seen.values() if "error" in record]
    assert all(record["wall_s"] > 0 and record["peak_mb"] > record["base_mb"] / 2 for record in seen.values())
    written = (tmp_path / OBSERVATIONS).read_text().splitlines()
    assert [json.loads(line) for line in written] == json.loads(json.dumps(records))
    assert [path.name for path in tmp_path.iterdir()] == [OBSERVATIONS]
    assert "process, 2 threads" in markdown(records)


@pytest.mark.soak
def test_all_of_it(tmp_path):
    records = run_session(Effort(size=LITTLE, live_lines=60, repetitions=1), tmp_path)
    assert not [record for record in records if record.get("error")]
    assert "lines behind" in markdown(records)
