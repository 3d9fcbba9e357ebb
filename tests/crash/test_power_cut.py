"""The power goes: what had not been synced may be gone, half there, or there by name only. What was called stored still is."""

from __future__ import annotations

import random
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from scanhsi import clock
from scanhsi.cube.records import LineStatus
from scanhsi.cube.verify import verify_cube
from scanhsi.devices.errors import CubeError
from support.cubes import frame
from support.faults import Fault, FaultyFs
from support.truth import check_complete, check_truth
from support.victims import MISSING, Job, Victims, write

HOWS = ("least", "names", "some", "others")
CODECS = ("lz4", "zstd", "none", "raw")


def cut_at(faulty: FaultyFs, victims: Victims, job: Job, change: int) -> int:
    """Write until a change; returns the lines that had been said to be safe."""
    pid = victims.start(job)
    faulty.arm(Fault(kill=pid, after=change))
    victims.go()
    end = victims.end()
    faulty.arm()
    assert end.error is None, end.error
    return end.safe


def cut_everywhere(folder: Path, faulty: FaultyFs, victims: Victims, job: Job, changes: list[int]) -> int:
    """At each of the changes, in every way; returns how many lines were safe in all."""
    total = 0
    for change in changes:
        safe = cut_at(faulty, victims, job, change)
        total += safe
        for how in HOWS:
            image = folder / how
            faulty.power_cut(image, how)
            cube = image / "cube.zarr"
            lines = check_truth(cube, job.spec, MISSING) if cube.exists() else 0
            assert lines >= safe, f"{how}, at change {change}: {safe} lines were said to be safe, {lines} are"
            shutil.rmtree(image)
        faulty.clear()
    return total


def count_changes(faulty: FaultyFs, job: Job) -> int:
    faulty.arm()
    clock.run(write(job), virtual=True)
    count = len(faulty.arm().changes)
    faulty.clear()
    return count


@pytest.fixture
def job(faulty: FaultyFs) -> Job:
    return Job(str(faulty.path / "cube.zarr"), lines=20, flush_every=14, fsync=True)


def test_stored_lines_survive(tmp_path: Path, faulty: FaultyFs, victims: Victims, job: Job) -> None:
    count = count_changes(faulty, job)
    changes = sorted(random.Random(5).sample(range(count // 4, count), 6))
    assert cut_everywhere(tmp_path, faulty, victims, job, changes) > 20


@pytest.mark.soak
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("codec", CODECS)
def test_stored_lines_survive_at_any_moment(
    tmp_path: Path, faulty: FaultyFs, victims: Victims, job: Job, codec: str
) -> None:
    job = replace(job, codec=codec)
    changes = list(range(2 * CODECS.index(codec), count_changes(faulty, job), 8))
    safe = cut_everywhere(tmp_path, faulty, victims, job, changes)
    sys.stderr.write(f"\n{codec}: power cut at {len(changes)} changes in {len(HOWS)} ways, {safe} safe lines, 0 lost\n")
    assert safe > 100


@pytest.mark.parametrize("durability", ["every shard", "at close"])
@pytest.mark.parametrize("codec", ["lz4", "raw"])
def test_a_closed_cube_survives(tmp_path: Path, faulty: FaultyFs, job: Job, codec: str, durability: str) -> None:
    job = replace(job, codec=codec, durability=durability)
    clock.run(write(job), virtual=True)
    for how in HOWS:
        faulty.power_cut(tmp_path / how, how)
        check_complete(tmp_path / how / "cube.zarr", job.spec, MISSING)


def test_at_close_promises_less_and_verify_tells(tmp_path: Path, faulty: FaultyFs, victims: Victims, job: Job) -> None:
    """Before such a cube is closed a power cut may damage it; then no line is wrong that ``verify`` does not name."""
    job = replace(job, durability="at close")
    count = count_changes(faulty, job)
    seen_bad = False
    for change in (count // 2, 2 * count // 3):
        cut_at(faulty, victims, job, change)
        for how in HOWS:
            image = tmp_path / f"{change}{how}"
            faulty.power_cut(image, how)
            seen_bad |= told_the_truth(image / "cube.zarr", job)
        faulty.clear()
    assert seen_bad, "if nothing can be lost, why have it"


def told_the_truth(cube: Path, job: Job) -> bool:
    """Whether ``verify`` found damage; every stored line that it does not name is exact."""
    import zarr

    try:
        found = verify_cube(cube)
    except CubeError:
        return True
    bad = set(found.bad_lines)
    pixels = zarr.open_group(cube, mode="r")["cube"]
    for line in (found.status == LineStatus.STORED).nonzero()[0].tolist():
        if line not in bad:
            assert (pixels[:, line] == frame(job.spec, line)).all()  # pyright: ignore
    return not found.intact


def test_resuming_takes_over_what_was_not_synced(tmp_path: Path, faulty: FaultyFs, victims: Victims, job: Job) -> None:
    """Begun ``at close`` and killed, resumed with every shard synced: once it is closed, all of it is on disk."""
    loose = replace(job, durability="at close")
    cut_at(faulty, victims, loose, count_changes(faulty, loose) // 2)
    clock.run(write(replace(job, resume=True)), virtual=True)
    for how in HOWS:
        faulty.power_cut(tmp_path / how, how)
        check_complete(tmp_path / how / "cube.zarr", job.spec, MISSING)
