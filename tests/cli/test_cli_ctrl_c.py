"""Ctrl-C at random moments of a real process: exit code, message and cube as `docs/reference/cli.md` says.

By hand, 100 moments: ``SCANHSI_SOAK_SEED=7 python -m pytest -m soak tests/cli/test_cli_ctrl_c.py -s``.
"""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

import numpy as np
import pytest

import scanhsi
from scanhsi.cli.codes import ExitCode
from scanhsi.cube import LineStatus
from scanhsi.cube.verify import verify_cube
from scanhsi_sim.scenes.testpattern import expected

LINES, BANDS, SAMPLES = 24, 40, 64
SCAN = (
    *("scan", "sensors2019", "--lines", LINES, "--exposure", "10 ms", "--pixel-format", "Mono8", "--json"),
    *("--set", "camera.scene=testpattern", "--set", "storage.lines_per_shard=4", "--set", "roi.sample_offset=0"),
    *("--set", f"roi.samples={SAMPLES}", "--set", f"roi.bands={BANDS}"),
)
FINISHING = "finishing the line and closing; Ctrl-C again to cancel it."
CANCELLING = "cancelling: stopping the mirror, closing cube and devices."
PATIENCE_S = 60.0


class From(Enum):
    """Since when a moment is counted."""

    LOADING = "the program is started"
    OPENED = "the cube is there, and the mirror is homed next"
    SCANNING = "the first line is told of"
    PAUSED = "the scan stands paused"


LASTS_S = {From.LOADING: 6.0, From.OPENED: 4.0, From.SCANNING: 1.2, From.PAUSED: 0.3}
"""Longest that a moment is away from there."""


@dataclass(frozen=True)
class Moment:
    """When Ctrl-C comes, and the second one after it."""

    since: From
    after_s: float
    again_after_s: float | None


def moments(count: int, seed: int) -> list[Moment]:
    """Moments of all kinds, every other with a second Ctrl-C."""
    chance = random.Random(seed)
    kinds = (From.OPENED, From.SCANNING, From.LOADING, From.SCANNING, From.PAUSED, From.OPENED, From.SCANNING)
    return [
        Moment(
            since := kinds[number % len(kinds)],
            chance.uniform(0, LASTS_S[since]),
            chance.uniform(0, 0.4) if number % 2 else None,
        )
        for number in range(count)
    ]


def interrupt(moment: Moment, out: Path) -> str:
    """Scan, interrupt, and look at everything that is left; what came of it."""
    words = [sys.executable, "-m", "scanhsi", *(str(word) for word in SCAN), "-o", str(out)]
    errors = out.with_suffix(".txt")
    with errors.open("w") as told, subprocess.Popen(words, stdout=subprocess.PIPE, stderr=told, text=True) as process:
        try:
            _wait_for(moment.since, process, out, errors)
            time.sleep(moment.after_s)
            process.send_signal(signal.SIGINT)
            if moment.again_after_s is not None:
                time.sleep(moment.again_after_s)
                process.send_signal(signal.SIGINT)
            result, _ = process.communicate(timeout=PATIENCE_S)
        finally:
            process.kill()
    return check(process.returncode, result, errors.read_text(), out)


def _wait_for(since: From, process: subprocess.Popen[str], out: Path, errors: Path) -> None:
    if since is From.LOADING:
        return
    _until(out.exists, process)
    if since is From.OPENED:
        return
    _until(lambda: "line 1/" in errors.read_text(), process)
    if since is From.PAUSED:
        process.send_signal(signal.SIGUSR1)
        _until(lambda: "\npaused" in errors.read_text(), process)


def _until(so: object, process: subprocess.Popen[str]) -> None:
    assert callable(so)
    deadline = time.monotonic() + PATIENCE_S
    while not so():
        assert process.poll() is None, "it ended by itself"
        assert time.monotonic() < deadline
        time.sleep(0.005)


def check(code: int, result: str, told: str, out: Path) -> str:
    """Compare with what is documented; what came of it, in a word."""
    if code == -signal.SIGINT or (code == ExitCode.INTERRUPTED and "connected" not in told):
        assert not out.exists()
        return "nothing begun"
    assert "Traceback" not in told, told
    held = check_cube(out) if out.exists() else None
    if code == ExitCode.OK:
        assert held == LINES
        assert json.loads(result)["stopped_early"] is False
        return "all done"
    assert code == ExitCode.INTERRUPTED, told
    report = json.loads(result)
    if "error" in report:
        assert CANCELLING in told
        assert report["error"]["type"] == "Interrupted"
        assert told.rstrip().endswith("interrupted.")
        assert held is None or f"what was stored before is safe: scanhsi info {out}" in told
        return "cancelled" if FINISHING in told else "cancelled before the scan"
    assert FINISHING in told
    assert CANCELLING not in told
    assert report["stopped_early"] is True
    assert report["stored"] == held < LINES
    return "stopped before the first line" if held == 0 else "stopped"


def check_cube(path: Path) -> int:
    """An intact cube in which every line from the first on is right, and nothing of a crash; the number of lines."""
    found = verify_cube(path, threads=1)
    assert found.intact, found.problems
    assert not found.untidy
    assert [file for file in path.parent.iterdir() if file.name.startswith(path.name)] == [path]
    cube = scanhsi.open_cube(path)
    status, steps, pixels = cube["status"].values, cube["mirror_step"].values, cube["cube"].values
    held = int(np.count_nonzero(status == LineStatus.STORED))
    assert cube.attrs["lines_stored"] == held
    assert bool(cube.attrs.get("complete", False)) is (held == LINES)
    for line in range(held):
        np.testing.assert_array_equal(pixels[:, line], expected(int(steps[line]), (BANDS, SAMPLES), bits=8))
    return held


def interrupt_at(chosen: list[Moment], folder: Path, together: int) -> Counter[str]:
    """All of them, a few at a time; how often what came of it."""
    with ThreadPoolExecutor(together) as threads:
        outs = [folder / f"{number}.zarr" for number in range(len(chosen))]
        done = [threads.submit(interrupt, moment, out) for moment, out in zip(chosen, outs, strict=True)]
    failed = [f"{moment}: {one.exception()!r}" for moment, one in zip(chosen, done, strict=True) if one.exception()]
    assert not failed, "\n".join(failed)
    return Counter(one.result() for one in done)


def test_ctrl_c_at_some_moments(tmp_path: Path) -> None:
    assert interrupt_at(moments(4, seed=1), tmp_path, together=2).total() == 4


@pytest.mark.soak
@pytest.mark.timeout(3600)
def test_ctrl_c_at_100_random_moments(tmp_path: Path) -> None:
    seed = int(os.environ.get("SCANHSI_SOAK_SEED", "1"))
    came = interrupt_at(moments(100, seed), tmp_path, together=2)
    sys.stdout.write(f"\nCtrl-C at 100 moments, seed {seed}: {dict(came)}\n")
    assert came["stopped"] > 5
    assert came["cancelled"] > 5
    assert came["stopped before the first line"] > 2
