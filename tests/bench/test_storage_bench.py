"""``scanhsi bench storage``: it measures what it says; how fast this computer is, is not tested."""

import json
import mmap
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from scanhsi.bench.storage import worker
from scanhsi.bench.storage.reading import readers, reads
from scanhsi.bench.storage.report import markdown
from scanhsi.bench.storage.rows import BY_KEY, FLOOR, ROWS, Row
from scanhsi.bench.storage.session import OBSERVATIONS, Effort, run_session
from scanhsi.bench.storage.work import Work, measure, memory_mb, synthetic_lines
from scanhsi.bench.storage.worker import Job
from scanhsi.clock import run

LITTLE = Work(21, 8, 12, lines_per_shard=8)
HERE = [row for row in ROWS if row.is_there]


@pytest.fixture
def frames(tmp_path: Path) -> Path:
    path = tmp_path / "frames.npy"
    np.save(path, synthetic_lines(8, 12, 5))
    return path


def job(row: Row, tmp_path: Path, **changes: object) -> Job:
    return Job(row.key, replace(LITTLE, **changes), str(tmp_path / "frames.npy"), str(tmp_path / "cube.zarr"))


@pytest.mark.parametrize("row", HERE, ids=lambda row: row.key)
@pytest.mark.usefixtures("frames")
def test_every_writer_stores_what_it_is_given(row: Row, tmp_path: Path) -> None:
    asked = job(row, tmp_path)
    assert Job.decoded(asked.encoded()) == asked
    seen = worker.run(asked)
    assert seen["stored_bytes"] > 0
    assert seen["wall_s"] > 0
    assert seen["append_p50_ms"] <= seen["append_p99_ms"] <= seen["append_max_ms"]
    assert seen["memory_mb"] > 10
    assert seen["late_p99_ms"] is None
    assert not (tmp_path / "cube.zarr").exists()


@pytest.mark.usefixtures("frames")
def test_lines_come_no_sooner_than_they_are_due(tmp_path: Path) -> None:
    seen = worker.run(job(BY_KEY["lz4"], tmp_path, rate=200.0))
    assert seen["wall_s"] >= 20 / 200
    assert seen["late_max_ms"] >= seen["late_p99_ms"] >= 0


@pytest.mark.parametrize("key", ["lz4", FLOOR, "zarr"])
def test_a_line_stored_wrong_makes_no_number(key: str, frames: Path, tmp_path: Path) -> None:
    given = np.load(frames)

    class Forgetful:
        def __init__(self, writer) -> None:
            self.append, self.finish, self.close, self.read = writer.take, writer.finish, writer.close, writer.read

        async def take(self, line, frame) -> None:
            await self.append(line, given[0] if line == LITTLE.lines - 1 else frame)

    async def main() -> None:
        async def make():
            return Forgetful(await BY_KEY[key].make(tmp_path / "cube.zarr", LITTLE))

        await measure(LITTLE, given[1:], make, tmp_path / "cube.zarr")

    with pytest.raises(ValueError, match="line 20 was stored otherwise"):
        run(main())


def test_frames_are_those_of_a_camera() -> None:
    lines = synthetic_lines(200, 300, 3)
    assert lines.dtype == np.uint16
    assert lines.max() <= 4095
    assert 780 < lines.mean() < 940
    assert not np.array_equal(lines[0], lines[1])
    noise = np.diff(lines[0].astype(float), axis=0).std() / np.sqrt(2)
    assert 10 < noise < 30, "shot noise is what cannot be compressed"


def test_memory_counts_what_is_shared_too() -> None:
    before = memory_mb()
    shared = mmap.mmap(-1, 64_000_000)
    np.frombuffer(shared, np.uint8)[:] = 1
    assert 60 < memory_mb() - before < 80


def test_a_session_takes_turns_and_keeps_what_it_saw(tmp_path: Path) -> None:
    unknown = replace(BY_KEY["zarr"], key="nobody", name="nobody")
    absent = replace(BY_KEY["tensorstore"], key="absent", needs="no_such_module")
    effort = Effort(
        rows=[BY_KEY[FLOOR], BY_KEY["lz4"], unknown, absent],
        flat_out=2,
        paced=1,
        reading=1,
        work=LITTLE,
        rate=500,
        paced_lines=9,
        reading_lines=20,
        frames=3,
    )
    effort = replace(effort, rows=[row if row.key == "lz4" else replace(row, paced=False) for row in effort.rows])
    records = run_session(effort, tmp_path)
    kept = [json.loads(line) for line in (tmp_path / OBSERVATIONS).read_text().splitlines()]
    assert kept == json.loads(json.dumps(records))
    flat = [(seen["repetition"], seen["row"]) for seen in records if seen["record"] == "flat out"]
    assert flat == [(0, FLOOR), (0, "lz4"), (0, "nobody"), (1, FLOOR), (1, "lz4"), (1, "nobody")]
    assert records[0]["missing"] == {"absent": "no_such_module"}
    assert [seen["row"] for seen in records if seen["record"] == "paced"] == ["lz4"]
    assert all(("error" in seen) == (seen["row"] == "nobody") for seen in records if "row" in seen)
    read = [seen for seen in records if seen["record"] == "read"]
    assert {(seen["cold"], seen["layout"]) for seen in read} == {
        (cold, f"shards 8 x {lines} x 12, chunks 8 x {lines} x 12") for cold in (False, True) for lines in (8, 32)
    }
    assert [path.name for path in tmp_path.iterdir()] == [OBSERVATIONS], "cubes are removed"
    text = markdown(records)
    assert "pip install no-such-module" in text
    assert "open_cube, chunks=None" in text


def test_what_is_read_is_what_was_meant(tmp_path: Path) -> None:
    assert set(readers(tmp_path)) >= {"open_cube, chunks=None", "open_cube, dask", "zarr-python", "xarray.open_zarr"}
    cube = np.empty((10, 200, 90))
    shapes = {what: cube[index].shape for what, index in reads(cube.shape).items()}
    assert shapes == {
        "band": (200, 90),
        "spectrum": (10,),
        "line": (10, 90),
        "colour": (3, 200, 90),
        "region": (10, 64, 64),
    }


def seen(row: str, repetition: int, wall_s: float, record: str = "flat out", **changes: object) -> dict[str, object]:
    taken = {
        "wall_s": wall_s,
        "cpu_s": 1.0,
        "memory_mb": 300.0,
        "append_p50_ms": 1.0,
        "append_p99_ms": 9.0,
        "append_max_ms": 20.0,
        "late_p99_ms": 3.0,
        "stored_bytes": 500_000_000,
    }
    work = {"lines": 100, "bands": 1000, "samples": 5000, "rate": 10.0}
    return {"record": record, "row": row, "repetition": repetition, "load": 1.0, "work": work, **taken, **changes}


def session() -> dict[str, object]:
    machine = {"processor": "P", "cpus": 2, "system": "Linux", "kernel": "6"}
    facts = {"started": "now", "machine": machine, "git": None, "packages": {}, "versions": {"python": "3"}}
    return {"record": "session", **facts, "missing": {}}


def test_ratios_are_taken_within_repetitions() -> None:
    slow_then_quick = [session()]
    for repetition, slower in enumerate([1, 10, 1]):
        slow_then_quick += [seen(FLOOR, repetition, 1.0 * slower), seen("raw", repetition, 1.25 * slower)]
        slow_then_quick += [seen("lz4", repetition, 2.0 * slower), seen("zarr", repetition, 1.6 * slower)]
    text = markdown(slow_then_quick)
    assert "| floor | 1000 (100–1000) | 1 |" in text
    assert "| **scanhsi** raw | 800 (80–800) | 0.80 |" in text
    assert "* **not met**: scanhsi raw / floor at least 0.85: 0.80" in text
    assert "* **not met**: zarr-python lz4 no faster than scanhsi lz4: 1.25 times" in text


def test_targets_of_paced_writing_are_judged() -> None:
    records = [session(), seen("lz4", 0, 10.0, "paced"), seen("lz4", 1, 10.0, "paced", append_max_ms=51.0)]
    text = markdown(records)
    assert "* met: scanhsi lz4 paced, append p99 below 10 ms: 9" in text
    assert "* **not met**: scanhsi lz4 paced, append max below 50 ms in every run: 51" in text
    assert "* met: scanhsi lz4 paced, below 0.5 core: 0.1" in text
    assert "* met: scanhsi lz4, at least 1.7 times smaller: 2.000" in text


def test_a_writer_that_failed_is_told(tmp_path: Path) -> None:
    text = markdown([session(), {"record": "flat out", "row": "acquire", "repetition": 0, "load": 1.0, "error": "a|b"}])
    assert "did not run here: a/b" in text
