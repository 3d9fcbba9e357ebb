"""Streams lines into a cube: the `LineSink` that stores.

Lines gather in slots, preallocated buffers of one shard each. The last line of a shard starts its commit, in threads, while the
next slots fill; commits run one after another, so what is safe is always a beginning of the scan. A commit writes the pixels,
takes the ``stored`` stamp, writes the records, then the status, each on disk before the next. No free slot means that ``append``
waits: that is the whole back-pressure.
"""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanhsi.clock import now_ns, run_blocking
from scanhsi.cube.layout import CubeSpec, choose_layout
from scanhsi.cube.records import NOT_STAMPED, STAGES, LineRecords, LineStatus
from scanhsi.cube.shards import Codec, CubeFiles, ShardRecords
from scanhsi.devices.errors import CubeError
from scanhsi.devices.frames import Pixels


class CubeWriter:
    """Writes one new cube.

    Args:
        path: The cube, conventionally ``*.zarr``. Nothing may be there; its folder must be.
        spec: Sizes, type and attributes.
        slots: Shards in memory: one fills while the others are being written. Memory is ``slots`` raw shards, always.
        lines_per_shard: Lines that become safe together; by default from the size of a line, see `choose_layout`.
        codec: ``lz4`` (default), ``zstd`` (smaller, slower) or ``none``. All lossless.
        clock_offset_ns: Unix time minus loop time, ns, for ``time``. Measured in ``open`` unless given.
    """

    def __init__(
        self,
        path: str | Path,
        spec: CubeSpec,
        *,
        slots: int = 3,
        lines_per_shard: int | None = None,
        codec: Codec = "lz4",
        clock_offset_ns: int | None = None,
    ) -> None:
        if slots < 2:
            raise ValueError(f"slots must be at least 2, one to fill while one is written, not {slots}")
        self._spec = spec
        self._layout = choose_layout(spec, lines_per_shard)
        self._files = CubeFiles(Path(path), spec, self._layout, codec)
        self._slots = slots
        self._offset_ns = clock_offset_ns
        self._records = LineRecords(0)
        self._status: NDArray[np.uint8] = np.zeros(spec.lines, np.uint8)
        self._buffers: list[Pixels] = []
        self._next = 0  # first line not yet appended
        self._submitted = 0  # first line of no commit
        self._safe = 0  # first line that is not on disk
        self._named = 0  # first line that no returned range has named
        self._missing_written = 0
        self._commits: deque[asyncio.Task[None]] = deque()
        self._opening: asyncio.Task[None] | None = None
        self._closing: asyncio.Task[None] | None = None
        self._failure: CubeError | None = None
        self._failure_raised = False
        self._notes: dict[str, Any] = {}

    @property
    def capacity(self) -> int:
        """Lines that may be in memory at once."""
        return self._slots * self._layout.lines_per_shard

    @property
    def output(self) -> str | None:
        """Path of the cube."""
        return str(self._files.path)

    def annotate(self, attributes: Mapping[str, Any]) -> None:
        """Root attributes to be written by ``close`` (the report of a scan, say). Plain JSON."""
        self._notes.update(attributes)

    async def open(self, records: LineRecords) -> None:
        """Create the cube at its planned size and allocate the slots.

        Raises:
            CubeExists: Something is at the path; it was not touched.
            CubeError: The cube cannot be created there.
            ValueError: ``records`` has another number of lines than the cube.
        """
        if records.lines != self._spec.lines:
            raise ValueError(f"records of {records.lines} lines do not fit a cube of {self._spec.lines}")
        if self._opening is not None:
            raise RuntimeError("a CubeWriter writes one cube, once")
        self._records = records
        if self._offset_ns is None:
            self._offset_ns = time.time_ns() - now_ns()
        head = {"clock_offset_ns": self._offset_ns, "acquisition": self._acquisition(finished=False)}
        self._opening = asyncio.create_task(self._open(head))
        await asyncio.shield(self._opening)

    async def _open(self, head: Mapping[str, Any]) -> None:
        await run_blocking(0.0, self._files.create, head)
        self._buffers = await run_blocking(0.0, self._allocate)

    def _allocate(self) -> list[Pixels]:
        shape = (self._layout.lines_per_shard, self._spec.bands, self._spec.samples)
        buffers: list[Pixels] = [np.empty(shape, self._spec.dtype) for _ in range(self._slots)]
        for buffer in buffers:
            buffer.fill(0)  # touch the pages now, not when the first lines arrive
        return buffers

    def buffer(self, line: int) -> Pixels | None:
        """The (band, sample) buffer of a line; its contents are undefined.

        Raises:
            RuntimeError: The line has been appended, or its buffer still holds a line that is not safe: the caller has more
                than `capacity` lines in flight.
        """
        if not self._buffers:
            raise RuntimeError("the cube is not open")
        if not self._next <= line < self._spec.lines:
            raise RuntimeError(
                f"line {line} is not one to be filled; the next one is {self._next} of {self._spec.lines}"
            )
        if not self._slot_is_free(line):
            raise RuntimeError(
                f"line {line} needs a buffer that is still being written; only {self.capacity} may be in flight"
            )
        return self._row(line)

    async def append(self, line: int) -> range:
        """Take a filled line, or one of ``records.missing``; return the lines that have become safe.

        Waits only when every slot is full. Cancelled while it waits, it has taken the line.

        Raises:
            CubeError: A commit failed; nothing more will be stored.
            RuntimeError: Not the next line in order.
        """
        self._raise_failure()
        if not self._buffers:
            raise RuntimeError("the cube is not open")
        if line != self._next or line >= self._spec.lines:
            raise RuntimeError(f"line {line} cannot be appended; the next one is {self._next} of {self._spec.lines}")
        self._take(line)
        if self._next % self._layout.lines_per_shard == 0 or self._next == self._spec.lines:
            self._submit()
        while self._next < self._spec.lines and not self._slot_is_free(self._next) and self._failure is None:
            await asyncio.shield(self._commits[0])
            self._reap()
        self._reap()
        return self._name_safe()

    async def flush(self) -> range:
        """Store everything appended; return the lines that became safe.

        In the middle of a shard this writes the shard as far as it goes, and again when it is full: do it in a pause, not for
        every line.

        Raises:
            CubeError: A commit failed.
        """
        self._raise_failure()
        self._submit()
        await self._drain()
        return self._name_safe()

    async def close(self) -> None:
        """Store everything appended, cut the arrays to the lines reached, and say in the cube how it ended. Idempotent.

        Raises:
            CubeError: A commit failed and no call has told it yet, or the cube could not be finished; it opens all the same.
        """
        if self._opening is None:
            return
        if self._closing is None:
            self._closing = asyncio.create_task(self._close(self._opening))
        await asyncio.shield(self._closing)
        self._raise_failure(again=False)

    async def _close(self, opening: asyncio.Task[None]) -> None:
        await asyncio.wait([opening])
        if opening.cancelled() or opening.exception() is not None:
            return  # open() has told it
        self._submit()
        await self._drain()
        attributes = {
            **self._notes,
            "complete": self._safe == self._spec.lines,
            "acquisition": self._acquisition(finished=True),
        }
        try:
            await run_blocking(0.0, self._files.finish, self._safe, attributes)
        finally:
            self._buffers = []

    def _row(self, line: int) -> Pixels:
        per_shard = self._layout.lines_per_shard
        return self._buffers[line // per_shard % self._slots][line % per_shard]

    def _slot_is_free(self, line: int) -> bool:
        """Whether the slot of a line is its own: the shard that had it before is on disk."""
        per_shard = self._layout.lines_per_shard
        return line // per_shard < self._safe // per_shard + self._slots

    def _take(self, line: int) -> None:
        if line in self._records.missing:
            self._row(line).fill(0)
            self._status[line] = LineStatus.MISSING
        else:
            self._status[line] = LineStatus.STORED
        self._next = line + 1

    def _submit(self) -> None:
        """Start the commit of what has been appended, behind the commits under way."""
        if self._submitted < self._next and self._failure is None:
            previous = self._commits[-1] if self._commits else None
            self._commits.append(asyncio.create_task(self._commit(previous, self._submitted, self._next)))
            self._submitted = self._next

    async def _commit(self, previous: asyncio.Task[None] | None, start: int, stop: int) -> None:
        """Commit lines ``start`` to ``stop`` of one shard. Never raises: the failure waits for the next call."""
        if previous is not None:
            await asyncio.wait([previous])
        if self._failure is not None:
            return
        per_shard = self._layout.lines_per_shard
        first = start // per_shard * per_shard
        rows = self._buffers[first // per_shard % self._slots][: stop - first]
        try:
            await run_blocking(0.0, self._files.write_pixels, first, rows)
            stored = self._status[start:stop] == LineStatus.STORED
            self._records.stamps["stored"][start:stop][stored] = now_ns()
            await run_blocking(0.0, self._files.write_records, self._shard_records(first, stop))
        except CubeError as error:
            self._failure = error
        except Exception as error:  # a bug, or a library that changed: it still must not vanish in a task
            self._failure = CubeError(f"cannot write lines {start} to {stop - 1} of {self.output}: {error!r}")
            self._failure.__cause__ = error
        else:
            self._records.status[start:stop] = self._status[start:stop]
            self._safe = stop

    def _shard_records(self, first: int, stop: int) -> ShardRecords:
        records = self._records
        lines = slice(first, stop)
        exposure_start = records.stamps["exposure_start"][lines]
        wall = np.where(exposure_start == NOT_STAMPED, NOT_STAMPED, exposure_start + (self._offset_ns or 0))
        columns: dict[str, NDArray[Any]] = {
            "time": wall,
            "mirror_step": records.mirror_step[lines].copy(),
            "mirror_angle_rad": records.mirror_angle_rad[lines].copy(),
            "frame_id": records.frame_id[lines].copy(),
            "device_ns": records.device_ns[lines].copy(),
            "smeared": records.smeared[lines].copy(),
        }
        columns |= {f"{stage}_ns": records.stamps[stage][lines].copy() for stage in STAGES}
        missing = {int(line): records.missing[int(line)] for line in self._missing_lines(stop)}
        changed = len(missing) > self._missing_written
        self._missing_written = len(missing)
        return ShardRecords(first, columns, self._status[lines].copy(), missing if changed else None)

    def _missing_lines(self, stop: int) -> NDArray[np.intp]:
        return np.flatnonzero(self._status[:stop] == LineStatus.MISSING)

    def _reap(self) -> None:
        while self._commits and self._commits[0].done():
            self._commits.popleft()

    async def _drain(self) -> None:
        while self._commits:
            await asyncio.wait([self._commits[0]])
            self._reap()

    def _name_safe(self) -> range:
        self._raise_failure()
        named, self._named = self._named, self._safe
        return range(named, self._safe)

    def _raise_failure(self, *, again: bool = True) -> None:
        if self._failure is not None and (again or not self._failure_raised):
            self._failure_raised = True
            raise self._failure

    def _acquisition(self, *, finished: bool) -> dict[str, Any]:
        now = datetime.fromtimestamp((now_ns() + (self._offset_ns or 0)) / 1e9, UTC).isoformat(timespec="milliseconds")
        before: dict[str, Any] = {"lines_planned": self._spec.lines}
        if not finished:
            self._started = now
            return {**before, "started": now, "finished": None}
        stored = int(np.count_nonzero(self._status[: self._safe] == LineStatus.STORED))
        return {
            **before,
            "started": self._started,
            "finished": now,
            "lines_reached": self._safe,
            "lines_stored": stored,
            "lines_missing": self._safe - stored,
        }
