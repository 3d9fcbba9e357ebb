"""A cube that is being written by another process reads as a beginning of the scan, at every moment."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from living_writer import MISSING, REACH, SPEC

from scanhsi.cube.reader import cube_summary, open_cube, read_records
from scanhsi.cube.records import NOT_STAMPED, LineStatus
from support.cubes import whole

EXPECTED = whole(SPEC, REACH)
EXPECTED[:, list(MISSING)] = 0


def look(path: Path, seen: int, chunks: str | None) -> int:
    """Open the cube and check every line of it; how many there are."""
    dataset = open_cube(path, chunks=chunks)  # type: ignore[arg-type]
    lines = dataset.sizes["line"]
    assert lines >= seen, "lines do not go away"
    assert dataset.attrs["lines_stored"] + dataset.attrs["lines_missing"] == lines
    np.testing.assert_array_equal(dataset["cube"].values, EXPECTED[:, :lines])
    stored = dataset["status"].values == LineStatus.STORED
    assert (dataset["stored_ns"].values[stored] != NOT_STAMPED).all()
    assert np.isfinite(dataset["mirror_angle_rad"].values[stored]).all()
    records = read_records(path)
    assert records.lines >= lines
    assert records.missing == {line: reason for line, reason in MISSING.items() if line < records.lines}
    assert cube_summary(path).lines_stored >= records.stored
    return lines


def test_always_a_consistent_beginning(tmp_path: Path) -> None:
    path = tmp_path / "cube.zarr"
    writer = subprocess.Popen([sys.executable, Path(__file__).with_name("living_writer.py"), path])
    try:
        lengths = [0]
        while writer.poll() is None:
            if path.exists():
                lengths.append(look(path, lengths[-1], ("auto", None)[len(lengths) % 2]))
            time.sleep(0.001)
        assert writer.returncode == 0
        assert len(set(lengths)) > 5, "the reader saw it grow"
        assert look(path, lengths[-1], None) == REACH
        assert not open_cube(path).attrs["complete"]
    finally:
        writer.kill()
        writer.wait()


def test_an_open_cube_stays_as_it_was(tmp_path: Path) -> None:
    """While the scan goes on behind it, and while its arrays are cut."""
    path = tmp_path / "cube.zarr"
    writer = subprocess.Popen([sys.executable, Path(__file__).with_name("living_writer.py"), path])
    try:
        while not path.exists() or open_cube(path).sizes["line"] < 10:
            time.sleep(0.005)
        dataset = open_cube(path)
        lines = dataset.sizes["line"]
        assert writer.wait(60) == 0
        np.testing.assert_array_equal(dataset["cube"].values, EXPECTED[:, :lines])
        assert (dataset["frame_id"].values[dataset["status"].values == 1] >= 7).all()
    finally:
        writer.kill()
        writer.wait()
