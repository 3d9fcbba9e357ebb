"""Where the mirror was between two times."""

import time
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from scanhsi_sim.twins.mirror import HISTORY, MirrorState, span_of
from support.mirror_file import MirrorFile

LOG = np.array([(0, 100), (1000, 101), (2000, 102), (3000, 100)])


@pytest.mark.parametrize(
    ("start_ns", "end_ns", "span"),
    [
        (0, 999, (100, 100)),
        (0, 1000, (100, 101)),
        (999, 1999, (100, 101)),
        (1000, 1999, (101, 101)),  # a step at the very start is over
        (1500, 1600, (101, 101)),
        (1000, 2000, (101, 102)),
        (0, 5000, (100, 102)),  # there and back
        (2500, 3500, (100, 102)),
        (3000, 3001, (100, 100)),
        (9000, 9999, (100, 100)),
        (-9, -1, (100, 100)),
    ],
)
def test_span(start_ns: int, end_ns: int, span: tuple[int, int]) -> None:
    assert span_of(LOG, start_ns, end_ns) == span


def test_the_file_remembers_where_the_mirror_was(tmp_path: Path) -> None:
    mirror = MirrorFile(tmp_path / "mirror", position=7)
    with MirrorState.open(mirror.path) as state:
        times = [time.monotonic_ns()]
        for position in (8, 9, 5):
            mirror.move_to(position)
            times.append(time.monotonic_ns())
        assert [state.span(start, end) for start, end in pairwise(times)] == [(7, 8), (8, 9), (5, 9)]


def test_a_ring_that_has_gone_round_knows_the_last_changes(tmp_path: Path) -> None:
    mirror = MirrorFile(tmp_path / "mirror", position=0)
    with MirrorState.open(mirror.path) as state:
        for position in range(1, HISTORY + 100):
            mirror.move_to(position)
        before = time.monotonic_ns()
        mirror.move_to(-1)
        assert state.span(before, time.monotonic_ns()) == (-1, HISTORY + 99)
        assert state.span(time.monotonic_ns() - 1, time.monotonic_ns()) == (-1, -1)
