"""Streams lines into a cube: the `LineSink` that stores.

Lines gather in slots, preallocated buffers of one shard each. The last line of a shard starts its commit, in threads, while the
next slots fill. A commit writes the pixels, takes the ``stored`` stamp, writes the records, then the status, each on disk before
the next. Several shards are under way at once, but their status is written in order, so what is safe is always a beginning of the
scan. No free slot means that ``append`` waits: that is the whole back-pressure.
"""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import Mapping
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from scanhsi.clock import now_ns, run_blocking
from scanhsi.cube.buffers import ShardBuffer
from scanhsi.cube.destination import Destination
from scanhsi.cube.layout import RECORDS, CubeSpec, choose_layout
from scanhsi.cube.places import destination_of
from scanhsi.cube.records import NOT_STAMPED, STAGES, LineRecords, LineStatus
from scanhsi.cube.resume import Interrupted, load_records, load_rows, read_interrupted
from scanhsi.cube.shards import Codec, CubeFiles, Durability, ShardPixels, ShardRecords, disk_error
from scanhsi.devices.errors import CubeError, NotACube
from scanhsi.devices.frames import Pixels


class CubeWriter:
    """Writes one new cube; `CubeWriter.resume` goes on with one that was interrupted.

    Memory is ``slots`` shards as they come from the camera, and for each of the two threads what its shard becomes on disk (with
    ``raw`` nothing), whatever the disk does.

    Args:
        path: The cube, conventionally ``*.zarr``: a path, whose folder must be there, or a URL (``s3://bucket/cube.zarr``). Nothing
            may be there. Or another `Destination`.
        spec: Sizes, type and attributes.
        slots: Shards in memory: one fills while the others are being written.
        lines_per_shard: Lines that become safe together; by default from the size of a line, see `choose_layout`.
        codec: ``lz4`` (default), ``zstd`` (smaller, slower), ``none``; or ``raw``: uncompressed and never copied, a frame an inner
            chunk, for streams that are too fast to be compressed. All lossless.
        durability: ``every shard``: a line is stored once it would survive a power cut. ``at close``: all of them are then; until
            then a power cut, though no killed process, may take stored lines, or damage them so that only ``verify`` tells.
        clock_offset_ns: Unix time minus loop time, ns, for ``time``. Measured in ``open`` unless given.
    """

    def __init__(
        self,
        path: str | Path | Destination,
        spec: CubeSpec,
        *,
        slots: int = 3,
        lines_per_shard: int | None = None,
        codec: Codec = "lz4",
        durability: Durability = "every shard",
        clock_offset_ns: int | None = None,
    ) -> None:
        if slots < 2:
            raise ValueError(f"slots must be at least 2, one to fill while one is written, not {slots}")
        self._spec = spec
        self._layout = choose_layout(spec, lines_per_shard, whole_frames=codec == "raw")
        self._files = CubeFiles(destination_of(path), spec, self._layout, codec, durability)
        self._slots = slots
        self._offset_ns = clock_offset_ns
        self._shift_ns = 0  # clock of the cube, that of the session that began it, minus clock of the loop
        self._records = LineRecords(0)
        self._status: NDArray[np.uint8] = np.zeros(spec.lines, np.uint8)
        self._buffers: list[ShardBuffer] = []
        self._next = 0  # first line not yet appended
        self._submitted = 0  # first line of no commit
        self._safe = 0  # first line that is not on disk
        self._named = 0  # first line that no returned range has named
        self._missing_written = self._incidents_written = 0
        self._commits: deque[asyncio.Task[None]] = deque()
        self._opening: asyncio.Task[None] | None = None
        self._closing: asyncio.Task[None] | None = None
        self._failure: CubeError | None = None
        self._failure_raised = False
        self._notes: dict[str, Any] = {}
        self._started = ""
        self._interrupted: Interrupted | None = None
        self._stored_rows: NDArray[Any] | None = None  # of the shard that was not full when the cube was interrupted

    @classmethod
    def resume(
        cls,
        path: str | Path | Destination,
        spec: CubeSpec,
        *,
        slots: int = 3,
        durability: Durability = "every shard",
        clock_offset_ns: int | None = None,
    ) -> Self:
        """Go on with a cube that was interrupted: killed, failed, or closed early. Reads a few small files.

        The lines that are there stay, with their records. The first line to be appended is `next_line`; ``open`` fills the records
        of the lines before it. Shards and codec are those of the cube.

        Args:
            path: The cube, or its `Destination`.
            spec: As it was begun with; what describes the session (``run``, ``versions``, ``devices``, ``real_time``) may differ.
            slots: As for a new cube.
            durability: As for a new cube.
            clock_offset_ns: As for a new cube. Stamps are stored on the clock of the session that began the cube.

        Raises:
            NotACube: There is none.
            CubeError: It is complete, of another plan, or damaged, or another process is writing it. Nothing was touched.
        """
        destination = destination_of(path)
        _lock(destination)
        try:
            cube = read_interrupted(destination, spec)
            per_shard = cube.layout.lines_per_shard
            writer = cls(
                destination,
                spec,
                slots=slots,
                lines_per_shard=per_shard,
                codec=cube.codec,
                durability=durability,
                clock_offset_ns=clock_offset_ns,
            )
        except BaseException:
            destination.unlock()
            raise
        writer._go_on(cube)
        return writer

    def _go_on(self, cube: Interrupted) -> None:
        self._interrupted = cube
        self._layout = cube.layout
        self._files = CubeFiles(self._files.destination, self._spec, cube.layout, cube.codec, self._files.durability)
        self._status[:] = cube.status
        self._next = self._submitted = self._safe = self._named = cube.next_line
        self._missing_written = len(cube.missing)

    @property
    def next_line(self) -> int:
        """The line to be appended next; of a cube that is resumed and not open yet, the first that is not there."""
        return self._next

    @property
    def capacity(self) -> int:
        """Lines that may be in memory at once, now: those of all slots, less what of a shard is stored already."""
        per_shard = self._layout.lines_per_shard
        return self._slots * per_shard - self._named % per_shard

    @property
    def lines_per_shard(self) -> int:
        """Lines that become safe together."""
        return self._layout.lines_per_shard

    @property
    def output(self) -> str | None:
        """Path of the cube."""
        return self._files.name

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
        self._opening = asyncio.create_task(self._open(self._offset_ns))
        await asyncio.shield(self._opening)

    async def _open(self, offset_ns: int) -> None:
        try:
            await (self._create(offset_ns) if self._interrupted is None else self._reopen(self._interrupted))
        except BaseException:
            self._files.destination.unlock()
            raise

    async def _create(self, offset_ns: int) -> None:
        self._started = self._wall_clock()
        head = {"clock_offset_ns": offset_ns, "acquisition": self._acquisition(finished=False)}
        await run_blocking(0.0, self._files.create, head)
        await self._allocate()

    async def _reopen(self, cube: Interrupted) -> None:
        self._shift_ns = (self._offset_ns or 0) - cube.clock_offset_ns
        self._started = cube.attributes["acquisition"]["started"]
        again = {key: self._spec.attributes[key] for key in ("run", "versions") if key in self._spec.attributes}
        resumed = [*cube.attributes.get("resumed", ()), {"line": cube.next_line, "at": self._wall_clock(), **again}]
        head = {
            "complete": False,
            "missing": {str(line): reason for line, reason in cube.missing.items()},
            "acquisition": self._acquisition(finished=False),
            "resumed": resumed,
        }
        destination = self._files.destination
        await run_blocking(0.0, load_records, destination, cube, self._records, self._shift_ns)
        self._records.run[cube.next_line :] = len(resumed)
        self._incidents_written = len(self._records.incidents)
        self._stored_rows = await run_blocking(0.0, load_rows, destination, cube)
        await run_blocking(0.0, self._files.reopen, cube.documents, head)
        await self._allocate()

    async def _allocate(self) -> None:
        self._buffers = [await run_blocking(0.0, self._files.allocate) for _ in range(self._slots)]

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
            if self._interrupted is not None:
                self._files.destination.unlock()
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
        attributes: dict[str, Any] = {
            **self._notes,
            "incidents": self._incidents(),
            "complete": self._safe == self._spec.lines,
            "acquisition": self._acquisition(finished=True),
        }
        try:
            await run_blocking(0.0, self._files.finish, self._safe, attributes)
        finally:
            self._buffers = []
            await run_blocking(0.0, self._files.destination.unlock)

    def _row(self, line: int) -> Pixels:
        per_shard = self._layout.lines_per_shard
        return self._buffers[line // per_shard % self._slots].rows[line % per_shard]

    def _slot_is_free(self, line: int) -> bool:
        """Whether the slot of a line is its own: the shard that had it before is on disk."""
        per_shard = self._layout.lines_per_shard
        return line // per_shard < self._safe // per_shard + self._slots

    def _take(self, line: int) -> None:
        lost = line in self._records.missing
        self._status[line] = LineStatus.MISSING if lost else LineStatus.STORED
        self._next = line + 1

    def _submit(self) -> None:
        """Start the commit of what has been appended, beside and behind the commits under way."""
        if self._submitted < self._next and self._failure is None:
            previous = self._commits[-1] if self._commits else None
            self._commits.append(asyncio.create_task(self._commit(previous, self._submitted, self._next)))
            self._submitted = self._next

    async def _commit(self, previous: asyncio.Task[None] | None, start: int, stop: int) -> None:
        """Commit lines ``start`` to ``stop`` of one shard. Never raises: the failure waits for the next call."""
        first = start // self._layout.lines_per_shard * self._layout.lines_per_shard
        if previous is not None and first < start:  # perhaps the same file, half full: not both at once
            await asyncio.wait([previous])
            previous = None
        failure: Exception | None = None
        records, stamp = None, NOT_STAMPED
        try:
            if self._failure is None:
                picture = await run_blocking(0.0, self._files.write_pixels, self._shard_pixels(first, stop))
                stamp = now_ns()
                records = self._shard_records(first, start, stop, stamp, picture)
                await run_blocking(0.0, self._files.write_columns, records)
        except Exception as error:
            failure = error
        if previous is not None:
            await asyncio.wait([previous])
        if self._failure is not None:
            return
        try:
            if failure is not None:
                raise failure
            assert records is not None
            records = replace(records, attributes=self._news(stop))
            await run_blocking(0.0, self._files.write_status, records)
        except CubeError as error:
            self._failure = error
        except Exception as error:  # a bug, or a library that changed: it still must not vanish in a task
            self._failure = CubeError(f"cannot write lines {start} to {stop - 1} of {self.output}: {error!r}")
            self._failure.__cause__ = error
        else:
            stored = self._status[start:stop] == LineStatus.STORED
            self._records.stamps["stored"][start:stop][stored] = stamp
            self._records.status[start:stop] = self._status[start:stop]
            self._safe = stop

    def _shard_pixels(self, first: int, stop: int) -> ShardPixels:
        buffer = self._buffers[first // self._layout.lines_per_shard % self._slots]
        lost = self._status[first:stop] == LineStatus.MISSING
        resumed = self._interrupted is not None and first <= self._interrupted.next_line < first + self.lines_per_shard
        return ShardPixels(first, buffer, lost, self._stored_rows if resumed else None)

    def _shard_records(
        self, first: int, start: int, stop: int, stamp: int, picture: NDArray[np.uint16] | None
    ) -> ShardRecords:
        """What is known of lines ``first`` to ``stop``, of which those from ``start`` on were stored at ``stamp``."""
        lines = slice(first, stop)
        columns = {variable.name: self._column(variable.name, lines) for variable in RECORDS}
        stored = self._status[start:stop] == LineStatus.STORED
        columns["stored_ns"][start - first :][stored] = stamp + self._shift_ns
        return ShardRecords(first, columns, self._status[lines].copy(), picture=picture)

    def _news(self, stop: int) -> dict[str, Any] | None:
        """Reasons of all lines missing before ``stop``, and all incidents; None where the last status told them already."""
        missing = {str(line): self._records.missing[line] for line in self._missing_lines(stop).tolist()}
        incidents = self._incidents()
        changed = len(missing) > self._missing_written or len(incidents) > self._incidents_written
        self._missing_written, self._incidents_written = len(missing), len(incidents)
        return {"missing": missing, "incidents": incidents} if changed else None

    def _incidents(self) -> list[dict[str, Any]]:
        return [incident.to_json(self._shift_ns) for incident in self._records.incidents]

    def _column(self, name: str, lines: slice) -> NDArray[Any]:
        """A per-line array as it is stored; stamps on the clock of the cube."""
        stage = "exposure_start" if name == "time" else name.removesuffix("_ns")
        if stage not in STAGES:
            return getattr(self._records, name)[lines].copy()
        shift = (self._offset_ns or 0) if name == "time" else self._shift_ns
        stamps = self._records.stamps[stage][lines]
        return np.where(stamps == NOT_STAMPED, NOT_STAMPED, stamps + shift)

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

    def _wall_clock(self) -> str:
        return datetime.fromtimestamp((now_ns() + (self._offset_ns or 0)) / 1e9, UTC).isoformat(timespec="milliseconds")

    def _acquisition(self, *, finished: bool) -> dict[str, Any]:
        begun: dict[str, Any] = {"lines_planned": self._spec.lines, "started": self._started}
        if not finished:
            return {**begun, "finished": None}
        stored = int(np.count_nonzero(self._status[: self._safe] == LineStatus.STORED))
        return {
            **begun,
            "finished": self._wall_clock(),
            "lines_reached": self._safe,
            "lines_stored": stored,
            "lines_missing": self._safe - stored,
        }


def _lock(destination: Destination) -> None:
    try:
        destination.lock()
    except BlockingIOError as error:
        raise CubeError(f"{destination.name} is being written by another process.") from error
    except (FileNotFoundError, NotADirectoryError) as error:
        raise NotACube(f"there is no cube at {destination.name}.") from error
    except OSError as error:
        raise disk_error(destination, error, needed=0) from error
