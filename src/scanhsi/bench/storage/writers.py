"""Our writer, the floor, and what others build around a library: whole shards from three slots."""

from __future__ import annotations

import asyncio
import mmap
import os
from collections.abc import Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import NDArray

from scanhsi.bench.storage.work import SLOTS, Work
from scanhsi.cube.buffers import aligned_memory
from scanhsi.cube.records import LineRecords
from scanhsi.cube.shards import Codec, Durability
from scanhsi.cube.writer import CubeWriter

Lines = NDArray[np.uint16]
WriteShard = Callable[[int, Lines, memoryview], Awaitable[None]]
"""Writes (line, band, sample) from a line on; the memory that the lines begin, in whole pages."""


class Ours:
    """`CubeWriter`."""

    def __init__(self, writer: CubeWriter, path: Path, durability: Durability) -> None:
        self._writer = writer
        self._path = path
        self._at_close = durability == "at close"

    @classmethod
    async def open(cls, path: Path, work: Work, codec: Codec, durability: Durability) -> Ours:
        """Create the cube."""
        writer = CubeWriter(path, work.spec, codec=codec, durability=durability, lines_per_shard=work.lines_per_shard)
        await writer.open(LineRecords(work.lines))
        return cls(writer, path, durability)

    async def take(self, line: int, frame: Lines | None) -> None:
        """See `scanhsi.bench.storage.work.Writer`."""
        buffer = self._writer.buffer(line)
        if frame is not None and buffer is not None:
            np.copyto(buffer, frame)
        await self._writer.append(line)

    async def finish(self) -> None:
        """With durability ``at close`` nothing is on disk before."""
        await (self._writer.close() if self._at_close else self._writer.flush())

    async def close(self) -> None:
        """Close the cube."""
        await self._writer.close()

    def read(self, line: int) -> Lines:
        """Through zarr-python."""
        return read_line(self._path, "cube", (slice(None), line))


class ByShards:
    """Three slots, two of them being written: what `CubeWriter` does, without records, status and a way to resume.

    Args:
        work: The work.
        lines_per_shard: Of a slot.
        write: Writes one.
        finish: Called when all are written.
        read: Reads a line.
        huge_pages: Of the slots, where the system has them, as our writer's.
    """

    def __init__(
        self,
        work: Work,
        lines_per_shard: int,
        write: WriteShard,
        *,
        finish: Callable[[], None],
        read: Callable[[int], Lines],
        huge_pages: bool = True,
    ) -> None:
        self._work = work
        self._per_shard = lines_per_shard
        self._write = write
        self._finish = finish
        self._read = read
        shape = (lines_per_shard, work.bands, work.samples)
        self._memory = [aligned_memory(lines_per_shard * work.spec.line_bytes) for _ in range(SLOTS)]
        for memory in self._memory if not huge_pages else ():
            cast("mmap.mmap", memory.obj).madvise(mmap.MADV_NOHUGEPAGE)
        self._slots = [np.ndarray(shape, np.uint16, memory) for memory in self._memory]
        for slot in self._slots:
            slot.fill(0)
        self._commits: list[asyncio.Future[None]] = []

    async def take(self, line: int, frame: Lines | None) -> None:
        """See `scanhsi.bench.storage.work.Writer`."""
        shard, row = divmod(line, self._per_shard)
        slot = self._slots[shard % SLOTS]
        if frame is not None:
            np.copyto(slot[row], frame)
        if row + 1 == self._per_shard or line + 1 == self._work.lines:
            written = self._write(line - row, slot[: row + 1], self._memory[shard % SLOTS])
            self._commits.append(asyncio.ensure_future(written))
            if len(self._commits) >= SLOTS:
                await self._commits[-SLOTS]

    async def finish(self) -> None:
        """Wait for all."""
        await asyncio.gather(*self._commits)
        self._finish()

    async def close(self) -> None:
        """Nothing is left."""

    def read(self, line: int) -> Lines:
        """Read a line."""
        return self._read(line)


def in_threads(write: Callable[[int, Lines, memoryview], None]) -> WriteShard:
    """Two threads that write shards."""
    threads = ThreadPoolExecutor(SLOTS - 1)

    async def write_shard(first: int, rows: Lines, memory: memoryview) -> None:
        await asyncio.get_running_loop().run_in_executor(threads, write, first, rows, memory)

    return write_shard


def floor(path: Path, work: Work, *, huge_pages: bool = True) -> ByShards:
    """The same bytes in files of the size of raw mode's shards: direct writes, data synced, two threads, nothing else."""
    path.mkdir()
    per_shard = work.layout(raw=True).lines_per_shard
    flags = os.O_WRONLY | os.O_CREAT
    direct = flags | os.O_DIRECT
    try:
        os.close(os.open(path / "probe", direct))
    except OSError:  # a file system in memory
        direct = flags

    def write(first: int, rows: Lines, memory: memoryview) -> None:
        descriptor = os.open(path / str(first // per_shard), direct)
        try:
            size = -(-rows.nbytes // 4096) * 4096
            done = 0
            while done < size:
                done += os.pwrite(descriptor, memory[done:size], done)
            os.fdatasync(descriptor)
        finally:
            os.close(descriptor)

    def read(line: int) -> Lines:
        shard, row = divmod(line, per_shard)
        pixels = work.bands * work.samples
        flat = np.fromfile(path / str(shard), np.uint16, pixels, offset=row * work.spec.line_bytes)
        return flat.reshape(work.bands, work.samples)

    return ByShards(work, per_shard, in_threads(write), finish=lambda: None, read=read, huge_pages=huge_pages)


def sync_tree(path: Path) -> None:
    """Put on disk what a library has left in the page cache: every file and every folder."""
    for entry in (path, *path.rglob("*")):
        descriptor = os.open(entry, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def read_line(path: Path, array: str, index: tuple[Any, ...]) -> Lines:
    """Part of an array, through zarr-python."""
    import zarr

    return np.asarray(zarr.open_array(path / array, mode="r")[index])


Packing = Literal["shards", "chunks"]
"""Whole shards as ours, or plain chunk files of so many lines, 64 bands, all samples."""
