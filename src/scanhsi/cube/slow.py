"""Storage that takes its time: for simulated instruments, whose delays say what storing costs."""

from __future__ import annotations

from collections.abc import Callable

from scanhsi.clock import now_ns, sleep_until_ns
from scanhsi.cube.records import LineRecords
from scanhsi.cube.sink import LineSink
from scanhsi.devices.frames import Pixels


class SlowSink:
    """A sink before which each line waits as long as storing it is to take, one line behind the other.

    Args:
        sink: Where the lines go.
        store_ns: Time to store a line, ns, by its number. A missing line takes none.
    """

    def __init__(self, sink: LineSink, store_ns: Callable[[int], int]) -> None:
        self._sink = sink
        self._store_ns = store_ns
        self._records = LineRecords(0)
        self._under_way: int | None = None

    @property
    def capacity(self) -> int:
        """Lines that may be in memory at once."""
        return self._sink.capacity

    @property
    def output(self) -> str | None:
        """Where the cube is."""
        return self._sink.output

    async def open(self, records: LineRecords) -> None:
        """Create the output."""
        self._records = records
        await self._sink.open(records)

    def buffer(self, line: int) -> Pixels | None:
        """The (band, sample) buffer of a line."""
        return self._sink.buffer(line)

    async def append(self, line: int) -> range:
        """Hand a line over once the time to store it has passed. Cancelled meanwhile, it has taken the line."""
        self._under_way = line
        if line not in self._records.missing:
            await sleep_until_ns(now_ns() + self._store_ns(line))
        self._under_way = None
        return await self._sink.append(line)

    async def flush(self) -> range:
        """Store whatever is still in memory."""
        return await self._sink.flush()

    async def close(self) -> None:
        """Store whatever was appended, and close the output. Idempotent."""
        line, self._under_way = self._under_way, None
        try:
            if line is not None:
                await self._sink.append(line)
        finally:
            await self._sink.close()
