"""What is measured. Each row runs in a process of its own; see `scanhsi.bench.processing.worker`."""

from __future__ import annotations

import asyncio
import os
import resource
import shutil
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from scanhsi.bench.processing.work import FULL_RATE, Size, chain, pipeline, repeat, write
from scanhsi.bench.storage.work import memory_mb
from scanhsi.cube.rewrite import Rewriting, open_source
from scanhsi.processing import LiveProcessing, process
from scanhsi.processing.live import Following
from scanhsi.processing.run import work_of

Told = dict[str, Any]
_COPY_BYTES: Final = 8_000_000
_CHUNK: Final = 4  # lines that the steps one by one take at a time


@dataclass(frozen=True, slots=True)
class Given:
    """What a row works on.

    Attributes:
        size: Of the raw cube.
        frames: Frames in memory, (frame, band, sample).
        folder: Has the raw cube ``raw.zarr`` and its pixels ``raw.bin``; others may be made in it.
    """

    size: Size
    frames: NDArray[np.uint16]
    folder: Path


def copy_lines(given: Given) -> Told:
    """Copy the lines in memory."""
    room = np.empty_like(given.frames)
    return _a_line(given, lambda: np.copyto(room, given.frames))


def compute(given: Given) -> Told:
    """The chain as it is run."""
    run, lines = pipeline(given.size), _blocks(given.frames)
    return _a_line(given, lambda: [run(block) for block in lines])


def compute_saturated(given: Given) -> Told:
    """The same with a tenth of all lines saturated in places."""
    run, frames = pipeline(given.size), given.frames.copy()
    frames[:, ::10, ::3] = 4095
    lines = _blocks(frames)
    return _a_line(given, lambda: [run(block) for block in lines])


def compute_in_steps(given: Given) -> Told:
    """The steps one after the other, each over all bands: what the chain would cost without being put together."""
    functions, lines = [step for _, step in pipeline(given.size).bound], _blocks(given.frames)

    def run() -> None:
        for values in lines:
            for function in functions:
                values = function(values)

    return _a_line(given, run)


def copy_file(given: Given) -> Told:
    """Read the raw pixels from the disk and write them to it, synced."""
    return _through(given, lambda: _copy(given.folder / "raw.bin", given.folder / "copy.bin"))


def rewrite(given: Given) -> Told:
    """Read the raw cube and write it again, as processing does, with nothing computed."""
    source = open_source(given.folder / "raw.zarr")
    target = given.folder / "copy.zarr"
    whole, _ = work_of(source, "raw.zarr", target, chain(given.size), "lz4")
    bare = replace(given.size.spec, attributes={})
    plain = Rewriting(source, target, bare, replace(whole.layout, shard=_raw(source), chunk=_chunk(source)))
    return _through(given, lambda: plain.run(threads=2))


def _raw(source: Any) -> tuple[int, int, int]:
    return tuple(source["cube"].encoding["shards"])


def _chunk(source: Any) -> tuple[int, int, int]:
    return tuple(source["cube"].encoding["chunks"])


def process_one(given: Given) -> Told:
    """From raw cube to reflectance cube with one thread."""
    return _process(given, 1)


def process_two(given: Given) -> Told:
    """With two threads."""
    return _process(given, 2)


def _process(given: Given, threads: int) -> Told:
    raw, made = given.folder / "raw.zarr", given.folder / "made.zarr"
    return _through(given, lambda: process(raw, made, chain(given.size), threads=threads))


def store_paced(given: Given) -> Told:
    """On one core: the raw cube is saved as lines come at the camera's full rate."""
    one_core()
    paced = asyncio.run(write(given.folder / "paced.zarr", given.size, given.frames, FULL_RATE, roll=False))
    return {**asdict(paced), "cpu_s": _cpu_s()}


def store_and_process(given: Given) -> Told:
    """On the same core: the same, with the reflectance cube made beside it."""
    one_core()

    async def run() -> Told:
        raw = given.folder / "paced.zarr"
        following = await Following.start(LiveProcessing(chain(given.size), given.folder / "made.zarr"), raw)
        try:
            paced = await write(raw, given.size, given.frames, FULL_RATE, roll=False)
            return {**asdict(paced), **asdict(await following.finish()), "cpu_s": _cpu_s()}
        finally:
            following.abandon()

    return asyncio.run(run())


ROWS: Final[dict[str, Callable[[Given], Told]]] = {
    "copy lines": copy_lines,
    "chain": compute,
    "chain, some saturated": compute_saturated,
    "step by step": compute_in_steps,
    "copy file": copy_file,
    "rewrite": rewrite,
    "process, 1 thread": process_one,
    "process, 2 threads": process_two,
    "store": store_paced,
    "store and process": store_and_process,
}
IN_MEMORY: Final = ("copy lines", "chain", "chain, some saturated", "step by step")
ON_DISK: Final = ("copy file", "rewrite", "process, 1 thread", "process, 2 threads")
LIVE: Final = ("store", "store and process")


def _cpu_s() -> float:
    """CPU time of this process, and of those that it started and that have ended."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


def one_core() -> None:
    """From now on this process, and what it starts, has one core."""
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})


def _blocks(frames: NDArray[np.uint16]) -> list[NDArray[np.uint16]]:
    """As they are handed over: (band, line, sample), some lines at a time."""
    starts = range(0, len(frames), _CHUNK)
    return [np.ascontiguousarray(frames[first : first + _CHUNK].transpose(1, 0, 2)) for first in starts]


def _a_line(given: Given, do: Callable[[], Any]) -> Told:
    one_core()
    do()
    return {"ms_a_line": 1e3 * repeat(do) / len(given.frames), "memory_mb": memory_mb()}


def _through(given: Given, do: Callable[[], Any]) -> Told:
    """Seconds from disk to disk; what is read is not in the page cache."""
    for path in given.folder.rglob("*"):
        if path.is_file():
            _forget(path)
    wall, cpu = time.perf_counter(), time.process_time()
    do()
    return {"wall_s": time.perf_counter() - wall, "cpu_s": time.process_time() - cpu}


def _forget(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.posix_fadvise(descriptor, 0, 0, os.POSIX_FADV_DONTNEED)
    finally:
        os.close(descriptor)


def _copy(source: Path, target: Path) -> None:
    room = bytearray(_COPY_BYTES)
    with source.open("rb", buffering=0) as read, target.open("wb", buffering=0) as written:
        while count := read.readinto(room):
            written.write(memoryview(room)[:count])
        os.fsync(written.fileno())


def clean(folder: Path) -> None:
    """Remove what a row made."""
    for name in ("copy.bin", "copy.zarr", "made.zarr", "paced.zarr"):
        path = folder / name
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)
