"""``kill -9`` at any moment, for every way of storing: nothing that was said to be safe is lost, and the rest can be resumed."""

from __future__ import annotations

import os
import random
import select
import shutil
import signal
import sys
import time
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest

from scanhsi import clock
from support.faults import Fault, FaultyFs
from support.truth import check_truth
from support.victims import LINES_PER_SHARD, MISSING, End, Job, Victims, write

WAYS = [(codec, durability) for codec in ("lz4", "zstd", "none", "raw") for durability in ("every shard", "at close")]
all_ways = pytest.mark.parametrize(("codec", "durability"), WAYS)


@dataclass
class Tally:
    """What became of the victims."""

    runs: int = 0
    killed: int = 0
    before_created: int = 0
    part: int = 0
    whole: int = 0
    said_safe: int = 0
    killed_again: int = 0

    def count(self, end: End, lines: int | None, planned: int) -> None:
        self.runs += 1
        self.killed += end.killed
        self.before_created += lines is None
        self.part += lines is not None and 0 < lines < planned
        self.whole += lines == planned
        self.said_safe += end.safe

    def __str__(self) -> str:
        return (
            f"{self.runs} runs, {self.killed} killed ({self.before_created} before there was a cube, {self.part} with some lines, "
            f"{self.whole} with all), {self.killed_again} killed again while resuming; "
            f"{self.said_safe} lines said to be safe, 0 lost"
        )


def judge(job: Job, cube: Path, end: End) -> int | None:
    """What is there after a victim's end is true, and as much as it had said; returns the lines there are."""
    assert end.error is None, end.error
    if not cube.exists():
        assert end.safe == 0
        return None
    lines = check_truth(cube, job.spec, MISSING)
    assert lines >= end.safe, f"{end.safe} lines were said to be safe, {lines} are"
    return lines


def complete(job: Job, cube: Path) -> None:
    """Go on where it ended, and check every pixel of the whole."""
    planned = job.lines
    there = check_truth(cube, job.spec, MISSING) if cube.exists() else None
    if there != planned or there is None:
        clock.run(write(replace(job, path=str(cube), resume=there is not None)), virtual=True)
    check_truth(cube, job.spec, MISSING)


def kill_at(victims: Victims, job: Job, sign: Path, delay_s: float) -> End:
    """Kill a victim so much later than a file has appeared."""
    victim = os.pidfd_open(victims.start(job))  # not its number, which may be somebody else's once it is done
    ended = select.poll()
    ended.register(victim, select.POLLIN)
    try:
        victims.go()
        while not sign.exists() and not ended.poll(0.2):
            pass
        time.sleep(delay_s)
        with suppress(ProcessLookupError):
            signal.pidfd_send_signal(victim, signal.SIGKILL)
    finally:
        os.close(victim)
    return victims.end()


def shard_duration_of(victims: Victims, job: Job) -> float:
    """What a shard takes, about; with what creating and closing takes, that is."""
    victims.start(job)
    begin = time.monotonic()
    victims.go()
    end = victims.end()
    duration_s = time.monotonic() - begin
    assert not end.killed
    assert end.error is None, end.error
    shutil.rmtree(job.path)
    return duration_s / (job.lines / LINES_PER_SHARD)


def kill_at_random(folder: Path, victims: Victims, job: Job, moments: int, seed: str) -> Tally:
    """Kill so many victims, half of them once more while they resume; complete each cube.

    Moments are random ones after the status of a random shard has appeared: counted from the start most would be too early or too
    late, for what a run takes depends on what else the computer does. One in ten is from the start on, before there is a cube.
    """
    rng, tally, cube = random.Random(seed), Tally(), Path(job.path)
    shard_s = min(shard_duration_of(victims, job) for _ in range(2))

    def moment(first: int) -> tuple[Path, float]:
        shard = rng.randrange(first - 1, job.lines // LINES_PER_SHARD)
        sign = folder if rng.random() < 0.1 else cube if shard < first else cube / "status/c" / str(shard)
        return sign, rng.uniform(0, shard_s)

    while tally.killed < moments:  # some are done before their moment comes
        assert tally.runs < 5 * moments
        end = kill_at(victims, job, *moment(0))
        lines = judge(job, cube, end)
        tally.count(end, lines, job.lines)
        if tally.runs % 2 and lines is not None and lines < job.lines:
            again = kill_at(victims, replace(job, resume=True), *moment(lines // LINES_PER_SHARD))
            assert (judge(job, cube, again) or 0) >= lines
            tally.killed_again += again.killed
        complete(job, cube)
        shutil.rmtree(cube)
        for left in folder.iterdir():
            assert left.name.startswith(f".{cube.name}."), left
            shutil.rmtree(left)
    return tally


@all_ways
@pytest.mark.usefixtures("no_sync")
def test_at_random_moments(tmp_path: Path, victims: Victims, codec: str, durability: str) -> None:
    job = Job(str(tmp_path / "cube.zarr"), codec=codec, durability=durability, flush_every=14)
    kill_at_random(tmp_path, victims, job, 2, f"{codec} {durability}")


@pytest.mark.soak
@pytest.mark.timeout(3600)
@all_ways
@pytest.mark.usefixtures("no_sync")
def test_at_200_random_moments(tmp_path: Path, victims: Victims, codec: str, durability: str) -> None:
    job = Job(str(tmp_path / "cube.zarr"), codec=codec, durability=durability, lines=30, flush_every=14)
    tally = kill_at_random(tmp_path, victims, job, 200, f"soak {codec} {durability}")
    sys.stderr.write(f"\n{codec}, {durability}: {tally}\n")


def changes_of(faulty: FaultyFs, victims: Victims, job: Job) -> list[str]:
    """What a whole run does to the file system."""
    faulty.arm()
    victims.start(job)
    victims.go()
    end = victims.end()
    assert end.error is None, end.error
    changes = faulty.arm().changes
    faulty.clear()
    return changes


def kill_between(faulty: FaultyFs, victims: Victims, job: Job, steps: list[int]) -> Tally:
    """Kill a victim at the n-th change of the file system, for every n in ``steps``; complete each cube."""
    tally = Tally()
    cube = faulty.backing / Path(job.path).name
    for step in steps:
        pid = victims.start(job)
        faulty.arm(Fault(kill=pid, after=step))
        victims.go()
        end = victims.end()
        faulty.arm()  # before anybody else has that process id
        lines = judge(job, cube, end)
        tally.count(end, lines, job.lines)
        complete(job, cube)
        faulty.clear()
    return tally


def on(faulty: FaultyFs, **options: Any) -> Job:
    return Job(str(faulty.path / "cube.zarr"), fsync=True, lines=20, **options)


def test_between_any_two_changes(faulty: FaultyFs, victims: Victims) -> None:
    job = on(faulty, flush_every=14)
    count = len(changes_of(faulty, victims, job))
    assert count > 200
    tally = kill_between(faulty, victims, job, random.Random(3).sample(range(count - 20), 10))
    assert tally.killed > 7  # threads may do things in another order, and less of some


@pytest.mark.soak
@pytest.mark.timeout(3600)
@all_ways
def test_between_every_two_changes(faulty: FaultyFs, victims: Victims, codec: str, durability: str) -> None:
    """Each way of storing gets an eighth of the moments, each another one."""
    job = on(faulty, flush_every=14, codec=codec, durability=durability)
    count = len(changes_of(faulty, victims, job))
    tally = kill_between(faulty, victims, job, list(range(WAYS.index((codec, durability)), count, len(WAYS))))
    sys.stderr.write(f"\n{codec}, {durability}, at every eighth of {count} changes: {tally}\n")
