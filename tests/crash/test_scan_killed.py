"""``kill -9`` at any moment of a whole scan, and a disk that fills up under one; then ``scanhsi scan --resume``."""

from __future__ import annotations

import random
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from test_killed import Tally, kill_at

from scanhsi.cli import run
from scanhsi.clock import run_virtual
from scanhsi.devices.errors import CubeError, ScanFailed
from support.faults import Fault, FaultyFs
from support.scans import LINES_PER_SHARD, check_finished, check_lines, scan_cube
from support.victims import End, Job, Victims

LINES = 30


def judge(cube: Path, end: End) -> int | None:
    assert end.error is None, end.error
    if not cube.exists():
        assert end.safe == 0
        return None
    lines = check_lines(cube)
    assert lines >= end.safe, f"{end.safe} lines were said to be safe, {lines} are"
    return lines


def finish(cube: Path, lines: int | None) -> None:
    """As a user would, from the command line; a cube that was never begun is begun, one that is whole is left alone."""
    if lines is None:
        run_virtual(scan_cube(cube, lines=LINES))
    else:
        code = run(["scan", "--resume", str(cube), "--virtual", "--json"])
        assert code == 0 or (code == 4 and lines == LINES)
    check_finished(cube, LINES)


def kill_at_random(folder: Path, victims: Victims, moments: int, seed: str, *, virtual: bool) -> Tally:
    """Kill so many scans, a third of them once more while they are resumed; finish each cube."""
    job = Job(str(folder / "cube.zarr"), lines=LINES, scan=True, virtual=virtual)
    cube, rng, tally = Path(job.path), random.Random(seed), Tally()
    shards = LINES // LINES_PER_SHARD
    while tally.killed < moments:
        assert tally.runs < 5 * moments
        shard = rng.randrange(-1, shards)
        sign = cube / f"status/c/{shard}" if shard >= 0 else folder
        delay_s = rng.uniform(0, 0.05 if virtual else 0.15)
        end = kill_at(victims, job, sign, delay_s)
        lines = judge(cube, end)
        tally.count(end, lines, LINES)
        if lines is not None and lines < LINES and tally.runs % 3 == 0:
            again = kill_at(victims, replace(job, resume=True), cube / f"status/c/{lines // LINES_PER_SHARD}", delay_s)
            assert (judge(cube, again) or 0) >= lines
            tally.killed_again += again.killed
            lines = judge(cube, again)
        finish(cube, lines)
        shutil.rmtree(cube)
        for left in folder.iterdir():
            assert left.name.startswith(f".{cube.name}."), left
            shutil.rmtree(left)
    return tally


@pytest.mark.usefixtures("no_sync")
def test_a_scan_killed_at_random_moments_is_finished(
    tmp_path: Path, victims: Victims, capsys: pytest.CaptureFixture[str]
) -> None:
    kill_at_random(tmp_path, victims, 6, "scan", virtual=True)
    assert '"stored": 30' in capsys.readouterr().out


@pytest.mark.soak
@pytest.mark.timeout(3600)
@pytest.mark.usefixtures("no_sync")
@pytest.mark.parametrize("virtual", [True, False])
def test_a_scan_killed_at_200_random_moments_is_finished(tmp_path: Path, victims: Victims, virtual: bool) -> None:
    tally = kill_at_random(tmp_path, victims, 200, f"scan soak {virtual}", virtual=virtual)
    sys.stderr.write(f"\n{'virtual' if virtual else 'real'} time: {tally}\n")


def fill_up(faulty: FaultyFs, parts: list[float]) -> None:
    """The disk is full in the middle of a scan; space is freed, and the scan finished."""
    cube, plenty = faulty.path / "cube.zarr", 1_000_000_000
    faulty.arm(Fault(room=plenty))
    run_virtual(scan_cube(cube, lines=LINES))
    whole = plenty - faulty.arm().room
    for part in parts:
        faulty.clear()
        said = [-1]
        faulty.arm(Fault(room=int(part * whole)))
        with pytest.raises((ScanFailed, CubeError), match="is full") as failed:
            run_virtual(scan_cube(cube, said.append, lines=LINES))
        faulty.arm()
        if isinstance(failed.value, CubeError):  # before there was a cube, and there is none
            assert not list(faulty.backing.iterdir())
            continue
        assert failed.value.stored >= said[-1] + 1
        assert check_lines(faulty.backing / cube.name) >= failed.value.stored
        assert run(["scan", "--resume", str(cube), "--virtual", "--json"]) == 0
        check_finished(faulty.backing / cube.name, LINES)


def test_the_disk_fills_up_in_the_middle_of_a_scan(faulty: FaultyFs) -> None:
    fill_up(faulty, [0.7])


@pytest.mark.soak
@pytest.mark.timeout(3600)
def test_the_disk_fills_up_at_any_moment_of_a_scan(faulty: FaultyFs) -> None:
    fill_up(faulty, [0.3 + 0.65 * number / 40 for number in range(40)])
