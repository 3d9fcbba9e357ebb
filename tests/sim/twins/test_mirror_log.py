"""Where the mirror was between two times, as the camera's twin remembers it."""

import subprocess
import sys
import time
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from scanhsi_sim.twins.mirror_log import span_of
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


WATCHER = """
import sys
from scanhsi_sim.twins.mirror_log import MirrorLog
log = MirrorLog(sys.argv[1])
print("ready", flush=True)
for line in sys.stdin:
    print(*log.span(*map(int, line.split())), flush=True)
"""


@pytest.mark.twin  # needs the compiler
def test_the_log_follows_the_mirror_whenever_it_is_asked(tmp_path: Path) -> None:
    mirror = MirrorFile(tmp_path / "mirror", position=7)
    command = [sys.executable, "-c", WATCHER, str(mirror.path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as watcher:
        assert watcher.stdin is not None
        assert watcher.stdout is not None
        watcher.stdout.readline()
        times = [time.monotonic_ns()]
        for position in (8, 9, 5):
            time.sleep(0.02)
            mirror.move_to(position)
            time.sleep(0.02)
            times.append(time.monotonic_ns())
        watcher.stdin.writelines(f"{start} {end}\n" for start, end in pairwise(times))
        watcher.stdin.close()
        assert watcher.stdout.read().split("\n")[:3] == ["7 8", "8 9", "5 9"]
