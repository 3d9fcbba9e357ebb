"""Where lines go: the contract between the scan engine and whatever stores them.

The engine calls, in one event loop::

    await sink.open(records)
    for each line, in order:
        out = sink.buffer(line)        # fill it: (band, sample)
        safe = await sink.append(line) # hand the filled buffer over; or a line listed in records.missing, unfilled
    safe = await sink.flush()          # whatever is still in memory
    await sink.close()                 # always, also after a failure or a cancellation

* **Credits.** At most `capacity` lines may be between ``buffer`` and being named in a returned range; the engine's credits see
  to it. That bounds the memory, whatever the disk does.
* **Truth.** A line is named in a returned range when its pixels are on disk, its ``stored`` stamp is taken, its records are on
  disk and then its ``status`` is. Ranges come in order and name each line once. Missing lines are named too (status `MISSING`,
  pixels zero).
* **Failure.** The first error is raised by the next ``append``, ``flush`` or ``close``; nothing is swallowed.
* **Cancellation.** ``append`` and ``flush`` may be cancelled; a buffer stays owned until the thread that reads it is done.
  ``close`` then still commits what was appended whole and leaves a valid, perhaps shorter cube.
"""

from __future__ import annotations

from typing import Protocol

from scanhsi.clock import now_ns
from scanhsi.cube.records import LineRecords, LineStatus
from scanhsi.devices.frames import Pixels


class LineSink(Protocol):
    """The contract; see the module docstring."""

    @property
    def capacity(self) -> int:
        """Lines that may be in memory at once, behind those that were named safe: the credits. May change as lines are named."""
        ...

    @property
    def output(self) -> str | None:
        """Where the cube is, for messages; None when nothing is stored."""
        ...

    async def open(self, records: LineRecords) -> None:
        """Create the output.

        Raises:
            CubeExists: It is there already; nothing was touched.
            CubeError: It cannot be created.
        """
        ...

    def buffer(self, line: int) -> Pixels | None:
        """The (band, sample) buffer of a line, contents undefined; None when nobody wants the pixels."""
        ...

    async def append(self, line: int) -> range:
        """Hand a line over; return the lines that have become safe meanwhile, perhaps none."""
        ...

    async def flush(self) -> range:
        """Store what is in memory; return the lines that became safe."""
        ...

    async def close(self) -> None:
        """Finish the output so that it opens as what it holds. Idempotent."""
        ...


class DiscardSink:
    """Lets every line go: for measuring what the instrument can do (``scanhsi scan --discard``)."""

    def __init__(self, capacity: int = 8) -> None:
        self._capacity = capacity
        self._records = LineRecords(0)

    @property
    def capacity(self) -> int:
        """Lines in flight."""
        return self._capacity

    @property
    def output(self) -> str | None:
        """Nothing is stored."""
        return None

    async def open(self, records: LineRecords) -> None:
        """Remember the records, to stamp lines as they pass."""
        self._records = records

    def buffer(self, line: int) -> Pixels | None:
        """Nobody wants the pixels."""
        del line

    async def append(self, line: int) -> range:
        """Let the line go at once. Its status stays `NOT_STORED`, for that is the truth, unless it is missing."""
        if line in self._records.missing:
            self._records.status[line] = LineStatus.MISSING
        else:
            self._records.stamps["stored"][line] = now_ns()
        return range(line, line + 1)

    async def flush(self) -> range:
        """Nothing is in memory."""
        return range(0)

    async def close(self) -> None:
        """Nothing to finish."""
