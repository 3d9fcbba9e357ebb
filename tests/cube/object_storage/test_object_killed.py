"""Scans straight to a bucket, killed at any moment: what the bucket says is stored is there, and the rest can be resumed."""

from __future__ import annotations

import random
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from scanhsi import clock
from scanhsi.cube.lease import KEY as LEASE
from scanhsi.cube.writer import CubeWriter
from scanhsi.devices.errors import CubeError, CubeExists, NotACube
from support.buckets import cube_copy, kill_after
from support.cubes import write_cube
from support.seaweed import S3
from support.truth import check_complete, check_truth
from support.victims import MISSING, End, Job, Victims, write


@pytest.fixture
def victims(server: S3) -> Iterator[Victims]:
    with Victims() as started:
        yield started


def judge(server: S3, job: Job, end: End, here: Path) -> int | None:
    """What is there is true, and as much as was said; the lines there are, None where there is no cube."""
    assert end.error is None, end.error
    cube = cube_copy(server, job.path, here)
    if cube is None:
        assert end.safe == 0
        return None
    lines = check_truth(cube, job.spec, MISSING)
    assert lines >= end.safe, f"{end.safe} lines were said to be safe, {lines} are"
    return lines


def kill_at_random(server: S3, victims: Victims, job: Job, here: Path, moments: int) -> list[int | None]:
    """Kill so many writers, every second cube's resumer, too; complete each cube. The lines that each kill left."""
    rng = random.Random(moments)
    left: list[int | None] = []
    for run in range(moments):
        this = replace(job, path=f"{job.path}-{run}")
        key = rng.choice([LEASE, "zarr.json", *(f"status/c/{shard}" for shard in range(job.lines // 6))])
        lines = judge(server, this, kill_after(victims, this, key, rng.uniform(0, 0.1)), here)
        left.append(lines)
        if lines is not None and lines < job.lines and run % 2:
            resume = replace(this, resume=True)
            again = kill_after(victims, resume, f"status/c/{lines // 6 + 1}", rng.uniform(0, 0.1))
            assert (judge(server, this, again, here) or 0) >= lines
        complete(victims, replace(this, resume=lines is not None))
        cube = cube_copy(server, this.path, here)
        assert cube is not None
        assert check_truth(cube, this.spec, MISSING) == job.lines
    return left


def complete(victims: Victims, job: Job) -> None:
    victims.start(job)
    victims.go()
    end = victims.end()
    assert end.error is None or "is complete" in end.error, end.error  # the resumer that was to be killed was faster


def test_killed_at_random_moments(server: S3, victims: Victims, url: str, here: Path) -> None:
    left = kill_at_random(server, victims, Job(url, flush_every=14), here, 3)
    assert any(lines for lines in left), left


@pytest.mark.soak
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("codec", ["lz4", "raw"])
def test_killed_at_50_random_moments(server: S3, victims: Victims, url: str, here: Path, codec: str) -> None:
    left = kill_at_random(server, victims, Job(url, codec=codec, flush_every=14), here, 50)
    before = sum(lines is None for lines in left)
    sys.stderr.write(f"\n{codec}: {len(left)} killed, {before} before there was a cube; 0 lines lost, all completed\n")


def test_written_and_gone_on_with(server: S3, url: str, here: Path) -> None:
    """The same bytes in a bucket as in a folder, through an interruption, and nothing but the cube."""
    job = Job(url)
    clock.run(write_cube(url, job.spec, reach=15, missing=MISSING, lines_per_shard=6))
    with pytest.raises(CubeExists, match=r"s3://.* exists already; nothing was written"):
        clock.run(write_cube(url, job.spec))
    clock.run(write(replace(job, resume=True)))
    cube = cube_copy(server, url, here)
    assert cube is not None
    check_complete(cube, job.spec, MISSING)
    with pytest.raises(CubeError, match="is complete"):
        CubeWriter.resume(url, job.spec)
    with pytest.raises(NotACube, match="there is no cube at"):
        CubeWriter.resume(f"{url}-not", job.spec)


def test_two_writers(server: S3, url: str) -> None:
    async def two() -> None:
        from scanhsi.cube.records import LineRecords

        spec = Job(url).spec
        first = CubeWriter(url, spec)
        await first.open(LineRecords(spec.lines))
        try:
            with pytest.raises(CubeError, match="is being written by another process"):
                CubeWriter.resume(url, spec)
            with pytest.raises(CubeExists):
                await CubeWriter(url, spec).open(LineRecords(spec.lines))
        finally:
            await first.close()

    clock.run(two())
