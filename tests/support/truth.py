"""Whether a cube is what was written into it: every pixel, every record, whatever happened to the writer."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from scanhsi.cube.layout import CubeSpec
from scanhsi.cube.reader import cube_summary, open_cube, read_records
from scanhsi.cube.records import NOT_STAMPED, LineStatus
from scanhsi.cube.verify import verify_cube
from support.cubes import frame


def check_truth(path: Path, spec: CubeSpec, missing: dict[int, str]) -> int:
    """What a cube says is stored is there, bit by bit, and ``verify`` agrees; returns how many lines there are a status of."""
    found = verify_cube(path, threads=1)
    assert found.intact, found.problems
    records = read_records(path)
    dataset = open_cube(path)
    pixels = dataset["cube"].values
    status = records.status.tolist()
    assert len(status) == found.lines_reached
    for line, state in enumerate(status):
        assert state == (LineStatus.MISSING if line in missing else LineStatus.STORED), (
            f"line {line} has status {state}"
        )
        if state == LineStatus.MISSING:
            assert records.missing[line] == missing[line]
            assert not pixels[:, line].any()
            continue
        np.testing.assert_array_equal(pixels[:, line], frame(spec, line))
        assert records.mirror_step[line] == 100 + 2 * line
        assert records.frame_id[line] == 7 + line
        assert records.stamps["stored"][line] != NOT_STAMPED
    return len(status)


def check_complete(path: Path, spec: CubeSpec, missing: dict[int, str]) -> None:
    """The same for a cube that must have all of its lines, and no trace of what happened."""
    assert check_truth(path, spec, missing) == spec.lines
    assert cube_summary(path).complete
    found = verify_cube(path, threads=1)
    assert not found.leftovers, found.leftovers
    assert not found.untidy
