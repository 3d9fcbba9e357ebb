"""A disk that fills up, fails or is taken away under a writer: a clear error, a valid cube, and bit-exact once it is mended."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from scanhsi import clock
from scanhsi.cube.reader import cube_summary
from scanhsi.cube.records import LineRecords
from scanhsi.cube.repair import repair_cube
from scanhsi.cube.verify import verify_cube
from scanhsi.cube.writer import CubeWriter
from scanhsi.devices.errors import CubeError
from support.faults import Fault, FaultyFs
from support.truth import check_complete, check_truth
from support.victims import MISSING, Job, write

WAYS = [(codec, durability) for codec in ("lz4", "zstd", "none", "raw") for durability in ("every shard", "at close")]
all_ways = pytest.mark.parametrize(("codec", "durability"), WAYS)


def job_on(faulty: FaultyFs, codec: str = "lz4", durability: str = "every shard") -> Job:
    return Job(str(faulty.path / "cube.zarr"), lines=20, codec=codec, durability=durability)


def write_until_fault(job: Job, fault: Fault, faulty: FaultyFs) -> tuple[int, CubeError | None]:
    """Write with a fault; the lines said to be safe, and how it was told."""
    said = [-1]
    faulty.arm(fault)
    try:
        clock.run(write(job, said.append), virtual=True)
    except CubeError as error:
        return said[-1] + 1, error
    return said[-1] + 1, None


def after_the_fault(job: Job, faulty: FaultyFs, safe: int) -> None:
    """The cube is true, or is not there; without the fault it is completed and exact, and nothing is left over."""
    cube = faulty.backing / "cube.zarr"
    assert not [left for left in faulty.backing.iterdir() if left != cube], "left beside the cube"
    lines = check_truth(cube, job.spec, MISSING) if cube.exists() else None
    assert (lines or 0) >= safe
    if lines is None or not cube_summary(cube).complete:
        clock.run(write(replace(job, resume=lines is not None)), virtual=True)
    check_complete(cube, job.spec, MISSING)


def check_error(error: CubeError | None, job: Job, *words: str) -> None:
    assert error is not None
    assert job.path in str(error)
    for word in words:
        assert word in str(error), error
    assert error.hint, "an error says what to try"


def bytes_of(job: Job, faulty: FaultyFs) -> int:
    """What a whole run writes."""
    plenty = 1_000_000_000
    faulty.arm(Fault(room=plenty))
    clock.run(write(job), virtual=True)
    used = plenty - faulty.arm().room
    faulty.clear()
    return used


def fill_up(faulty: FaultyFs, job: Job, parts: Sequence[float]) -> None:
    whole = bytes_of(job, faulty)
    for part in parts:
        safe, error = write_until_fault(job, Fault(room=int(part * whole)), faulty)
        check_error(error, job, "is full", "free some space")
        faulty.arm()
        after_the_fault(job, faulty, safe)
        faulty.clear()


@pytest.mark.parametrize(("codec", "durability"), [("lz4", "at close"), ("raw", "every shard")])
def test_the_disk_fills_up(faulty: FaultyFs, codec: str, durability: str) -> None:
    fill_up(faulty, job_on(faulty, codec, durability), (0.1, 0.7))


@pytest.mark.soak
@pytest.mark.timeout(3600)
@all_ways
def test_the_disk_fills_up_at_any_moment(faulty: FaultyFs, codec: str, durability: str) -> None:
    fill_up(faulty, job_on(faulty, codec, durability), np.linspace(0.01, 0.99, 20).tolist())


def fail_from(faulty: FaultyFs, job: Job, error_name: str, parts: Sequence[float]) -> None:
    """From some change on, nothing can be changed any more."""
    faulty.arm()
    clock.run(write(job), virtual=True)
    count = len(faulty.arm().changes)
    faulty.clear()
    for part in parts:
        safe, error = write_until_fault(job, Fault(error=error_name, after=int(part * count)), faulty)
        if faulty.arm().fired:  # else, near the end, it did with fewer changes this time
            check_error(error, job)
        mend_leftovers(faulty)
        after_the_fault(job, faulty, safe)
        faulty.clear()


@pytest.mark.parametrize("error_name", ["EIO", "EROFS", "EACCES", "EDQUOT", "ESTALE"])
def test_the_disk_fails_for_good(faulty: FaultyFs, error_name: str) -> None:
    """Gone, read-only, forbidden."""
    fail_from(faulty, job_on(faulty), error_name, (0, 0.5))


@pytest.mark.soak
@pytest.mark.timeout(3600)
@all_ways
def test_the_disk_fails_at_any_moment(faulty: FaultyFs, codec: str, durability: str) -> None:
    fail_from(faulty, job_on(faulty, codec, durability), "EROFS", np.linspace(0, 0.999, 20).tolist())


def mend_leftovers(faulty: FaultyFs) -> None:
    """On a disk that allows no change, temporary files cannot be removed either: what is left must be known as such."""
    cube = faulty.backing / "cube.zarr"
    if cube.exists():
        found = verify_cube(cube)
        assert all(leftover.ours for leftover in found.leftovers), found.leftovers
    for left in faulty.backing.iterdir():
        if left != cube:
            assert left.name.startswith(".cube.zarr.")
            assert left.name.endswith(".partial")
            shutil.rmtree(left)


def fail_once(faulty: FaultyFs, job: Job, op: str, parts: Sequence[float]) -> None:
    """One write, sync or rename fails and the next ones would work: the failure is told all the same."""
    faulty.arm()
    clock.run(write(job), virtual=True)
    count = sum(change.startswith(f"{op} ") for change in faulty.arm().changes)
    faulty.clear()
    assert count > 20
    for part in parts:
        fault = Fault(error="EIO", ops=(op,), after=int(part * count), once=True)
        safe, error = write_until_fault(job, fault, faulty)
        if faulty.arm().fired:
            check_error(error, job, "Input/output error")
        after_the_fault(job, faulty, safe)
        faulty.clear()


@pytest.mark.parametrize(("op", "codec"), [("write", "lz4"), ("write", "raw"), ("fsync", "lz4"), ("rename", "zstd")])
def test_one_operation_fails(faulty: FaultyFs, codec: str, op: str) -> None:
    fail_once(faulty, job_on(faulty, codec), op, (0.3, 0.6))


@pytest.mark.soak
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("op", ["write", "fsync", "rename", "create"])
@all_ways
def test_any_operation_fails(faulty: FaultyFs, codec: str, durability: str, op: str) -> None:
    fail_once(faulty, job_on(faulty, codec, durability), op, np.linspace(0, 0.999, 8).tolist())


def test_direct_writes_are_refused(faulty: FaultyFs) -> None:
    """A file system that knows no direct writes is written to without them, and nobody is bothered."""
    job = job_on(faulty, "raw")
    safe, error = write_until_fault(job, Fault(error="EINVAL", ops=("direct",)), faulty)
    assert error is None
    assert safe == job.lines
    assert faulty.arm().fired
    check_complete(faulty.backing / "cube.zarr", job.spec, MISSING)


def test_a_slow_disk_makes_the_writer_wait(faulty: FaultyFs) -> None:
    job = job_on(faulty)
    safe, error = write_until_fault(job, Fault(delay_s=0.002), faulty)
    assert (safe, error) == (job.lines, None)
    check_complete(faulty.backing / "cube.zarr", job.spec, MISSING)


def test_nothing_is_tidied_while_somebody_writes(tmp_path: Path) -> None:
    job = Job(str(tmp_path / "cube.zarr"), lines=20)

    async def main() -> None:
        writer = CubeWriter(job.path, job.spec)
        await writer.open(LineRecords(job.lines))
        with pytest.raises(CubeError, match="is being written"):
            repair_cube(job.path)
        await writer.close()
        repair_cube(job.path)

    clock.run(main(), virtual=True)
