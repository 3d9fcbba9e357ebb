"""Cubes that go to a bucket through a local spool: killed, slow and broken links, full spools."""

from __future__ import annotations

import random
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from urllib.parse import quote

import pytest

from scanhsi import clock
from scanhsi.cube.drain import Draining, drain
from scanhsi.cube.lease import KEY
from scanhsi.cube.location import locate
from scanhsi.cube.records import LineRecords
from scanhsi.cube.spooled import SpooledDestination
from scanhsi.cube.writer import CubeWriter
from scanhsi.devices.errors import CubeError, CubeExists
from support.buckets import cube_copy, kill_after
from support.cubes import feed
from support.seaweed import S3, SECRET
from support.slow_link import SlowLink, slow_link
from support.truth import check_complete, check_truth
from support.victims import MISSING, Job, Victims, write


@pytest.fixture
def spool(tmp_path: Path) -> Path:
    return tmp_path / "spool"


@pytest.fixture
def link(server: S3, monkeypatch: pytest.MonkeyPatch) -> Iterator[SlowLink]:
    """What every client in this test, or started by it, goes through."""
    with slow_link(server.endpoint) as link:
        monkeypatch.setenv("AWS_ENDPOINT_URL", link.endpoint)
        yield link


@pytest.fixture
def victims(link: SlowLink) -> Iterator[Victims]:
    with Victims() as started:
        yield started


def spooled(spool: Path, key: str) -> Callable[[], bool]:
    """Whether a change of that key waits in a spool."""
    name = quote(key, safe="")
    return lambda: any(spool.glob(f"*/*.put.{name}"))


def there(server: S3, url: str, here: Path, job: Job) -> int:
    """Lines in the bucket, all of them true."""
    cube = cube_copy(server, url, here)
    return 0 if cube is None else check_truth(cube, job.spec, MISSING)


def kill_and_drain(server: S3, victims: Victims, job: Job, here: Path, rng: random.Random) -> tuple[int, int, int]:
    """(lines in the bucket after the kill, lines said to be safe, lines in the bucket once drained)"""
    key = rng.choice([KEY, "zarr.json", "status/c/0", "status/c/2", "status/c/4"])
    end = kill_after(victims, job, key, rng.uniform(0, 0.15))
    assert end.error is None, end.error
    at_death = there(server, job.path, here, job)
    drain(job.spool)
    drained = there(server, job.path, here, job)
    assert at_death <= drained
    assert drained >= end.safe
    if drained < job.lines or "zarr.json" not in server.contents(job.path):
        resume = "zarr.json" in server.contents(job.path)
        clock.run(write(replace(job, resume=resume)))
    drain(job.spool)
    cube = cube_copy(server, job.path, here)
    assert cube is not None
    assert check_truth(cube, job.spec, MISSING) == job.lines
    assert list(Path(job.spool).iterdir()) == []
    assert KEY not in server.contents(job.path)
    return at_death, end.safe, drained


def test_killed_and_drained(server: S3, link: SlowLink, victims: Victims, url: str, spool: Path, here: Path) -> None:
    rng = random.Random(5)
    link.bytes_per_s = 300_000
    lines: list[tuple[int, int, int]] = []
    for run in range(2):
        job = Job(f"{url}-{run}", spool=str(spool), flush_every=14)
        lines.append(kill_and_drain(server, victims, job, here, rng))
    assert any(at_death < safe for at_death, safe, _ in lines), "the spool was of use"


@pytest.mark.soak
@pytest.mark.timeout(3600)
def test_killed_and_drained_often(
    server: S3, link: SlowLink, victims: Victims, url: str, spool: Path, here: Path
) -> None:
    rng = random.Random(6)
    for run in range(30):
        link.bytes_per_s = 10 ** rng.uniform(5.3, 7)
        job = Job(f"{url}-{run}", spool=str(spool), flush_every=14)
        kill_and_drain(server, victims, job, here, rng)


async def append_all(job: Job, destination: SpooledDestination, *, resume: bool = False) -> None:
    records = LineRecords(job.lines)
    new = CubeWriter(destination, job.spec, lines_per_shard=6, slots=2)
    writer = CubeWriter.resume(destination, job.spec) if resume else new
    first = writer.next_line
    await writer.open(records)
    try:
        await feed(writer, job.spec, records, range(first, job.lines), MISSING)
        await writer.flush()
    finally:
        await writer.close()


def test_a_slow_link_holds_nobody_up(server: S3, link: SlowLink, url: str, spool: Path, here: Path) -> None:
    job = Job(url, spool=str(spool))
    destination = SpooledDestination(locate(url), spool)
    link.bytes_per_s = 200_000
    clock.run(append_all(job, destination))
    assert not destination.drained(0), "the scan is over, the link is still busy"
    with pytest.raises(CubeError, match="its spool .* is in use"):
        CubeWriter.resume(SpooledDestination(locate(url), spool), job.spec)
    with pytest.raises(CubeError, match="lines of it wait in the spool"):
        CubeWriter.resume(url, job.spec)
    link.bytes_per_s = 1e9
    seen: list[Draining] = []
    assert drain(spool, progress=seen.append) == [url]
    assert all(state.elsewhere for state in seen)
    assert destination.drained(10)
    assert list(spool.iterdir()) == []
    cube = cube_copy(server, url, here)
    assert cube is not None
    check_complete(cube, job.spec, MISSING)
    assert drain(spool) == []


def test_the_spool_is_bounded(server: S3, link: SlowLink, url: str, spool: Path, here: Path) -> None:
    job = Job(url, spool=str(spool), lines=60)
    destination = SpooledDestination(locate(url), spool, max_bytes=60_000)
    link.bytes_per_s = 1_000_000
    most = 0

    def watch() -> None:
        nonlocal most
        while not destination.drained(0.002):
            try:
                most = max(most, sum(file.stat().st_size for file in destination.folder.iterdir()))
            except FileNotFoundError:
                continue

    watcher = threading.Thread(target=watch)
    clock.run(append_all_watched(job, destination, watcher))
    watcher.join()
    assert most < 60_000 + 20_000, "and its head, and what was removed in this moment"
    assert there(server, url, here, job) == job.lines


async def append_all_watched(job: Job, destination: SpooledDestination, watcher: threading.Thread) -> None:
    records = LineRecords(job.lines)
    writer = CubeWriter(destination, job.spec, lines_per_shard=6, slots=2)
    await writer.open(records)
    watcher.start()
    try:
        await feed(writer, job.spec, records, range(job.lines), MISSING)
    finally:
        await writer.close()


def test_a_broken_link(server: S3, link: SlowLink, url: str, spool: Path, here: Path) -> None:
    """A spool that is full while the link is broken ends the scan, in words; nothing is lost, and it can be gone on with."""
    job = Job(url, spool=str(spool), lines=60)
    destination = SpooledDestination(locate(url), spool, max_bytes=80_000, patience_s=0.5)

    async def scan() -> None:
        records = LineRecords(job.lines)
        writer = CubeWriter(destination, job.spec, lines_per_shard=6, slots=2)
        await writer.open(records)
        link.cut()
        try:
            await feed(writer, job.spec, records, range(job.lines), MISSING)
        finally:
            await writer.close()

    with pytest.raises(CubeError, match=r"the spool .* is full, and nothing leaves it.* Try: scanhsi drain") as caught:
        clock.run(scan())
    assert SECRET not in str(caught.value)
    assert there(server, url, here, job) == 0
    link.mend()
    drain(spool)
    lines = there(server, url, here, job)
    assert 0 < lines < job.lines
    assert destination.drained(60)
    clock.run(append_all(job, SpooledDestination(locate(url), spool), resume=True))
    drain(spool)
    cube = cube_copy(server, url, here)
    assert cube is not None
    check_complete(cube, job.spec, MISSING)


def test_resumed_before_it_was_drained(
    server: S3, link: SlowLink, victims: Victims, url: str, spool: Path, here: Path
) -> None:
    """Lines that wait in the spool count; a cube that is complete there is complete."""
    link.bytes_per_s = 100_000
    job = Job(url, spool=str(spool), lines=100)
    end = kill_after(victims, job, spooled(spool, "status/c/4"), 0.02)
    assert end.killed
    assert end.safe > there(server, url, here, job)
    secrets = [file for file in spool.rglob("*") if file.is_file() and SECRET.encode() in file.read_bytes()]
    assert not secrets
    link.bytes_per_s = 1e9
    writer = CubeWriter.resume(SpooledDestination(locate(url), spool), job.spec)
    assert writer.next_line >= end.safe
    clock.run(finish(writer, job))
    drain(spool)
    cube = cube_copy(server, url, here)
    assert cube is not None
    check_complete(cube, job.spec, MISSING)


async def finish(writer: CubeWriter, job: Job) -> None:
    records = LineRecords(job.lines)
    first = writer.next_line
    await writer.open(records)
    try:
        await feed(writer, job.spec, records, range(first, job.lines), MISSING)
    finally:
        await writer.close()


def test_gone_on_with_without_the_spool(
    server: S3, link: SlowLink, victims: Victims, url: str, spool: Path, here: Path
) -> None:
    """Somebody gave the spool up for lost; when it turns up, it must not overwrite what was measured since."""
    link.bytes_per_s = 100_000
    job = Job(url, spool=str(spool))
    kill_after(victims, job, spooled(spool, "status/c/4"), 0.0)
    link.bytes_per_s = 1e9
    server.remove(f"{url}/{KEY}")
    clock.run(write(replace(job, resume=True, spool="")))
    with pytest.raises(CubeError, match="another writer has gone on with it since"):
        drain(spool)
    cube = cube_copy(server, url, here)
    assert cube is not None
    check_complete(cube, job.spec, MISSING)


def test_nothing_is_overwritten(server: S3, link: SlowLink, url: str, spool: Path) -> None:
    job = Job(url, lines=8)
    clock.run(write(job))
    with pytest.raises(CubeExists):
        clock.run(write(replace(job, spool=str(spool))))
    assert list(spool.iterdir()) == []
    with pytest.raises(CubeError, match="is a folder: a spool is for cubes at URLs"):
        clock.run(write(replace(job, path="/tmp/a.zarr", spool=str(spool))))


def test_no_such_spool(tmp_path: Path) -> None:
    with pytest.raises(CubeError, match="there is no spool folder"):
        drain(tmp_path / "no")
