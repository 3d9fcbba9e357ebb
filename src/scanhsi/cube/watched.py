"""Lines seen as they pass: for live pictures of a scan, and of an instrument that stores nothing."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from scanhsi.clock import now_ns, sleep_until_ns
from scanhsi.cube.records import LineRecords
from scanhsi.cube.sink import LineSink
from scanhsi.devices.frames import Pixels
from scanhsi.devices.pixels import PixelFormat

Watch = Callable[[int, Pixels, LineRecords], None]
"""Called in the event loop with each line that came: its number, its pixels (band, sample), which are only to be read and only
until it returns, and the records of the scan. It delays the line: it copies what it wants and returns."""


class WatchedSink:
    """A sink whose lines are shown to somebody on their way.

    Args:
        sink: Where the lines go; one that discards them gets buffers from here.
        watch: Whom they are shown to.
        shape: (bands, samples) of a line.
        pixel_format: Of the lines.
        period_s: Least time from line to line, waited for before a line goes on.
    """

    def __init__(
        self, sink: LineSink, watch: Watch, shape: tuple[int, int], pixel_format: PixelFormat, period_s: float = 0.0
    ) -> None:
        self._sink = sink
        self._watch = watch
        self._shape = shape
        self._dtype = pixel_format.dtype
        self._period_ns = round(period_s * 1e9)
        self._own: list[Pixels] = []
        self._records = LineRecords(0)
        self._last_ns = 0

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

    def buffer(self, line: int) -> Pixels:
        """The (band, sample) buffer of a line; of our own where the sink wants none."""
        theirs = self._sink.buffer(line)
        if theirs is not None:
            return theirs
        if not self._own:
            self._own = [np.zeros(self._shape, self._dtype) for _ in range(self.capacity)]
        return self._own[line % self.capacity]

    async def append(self, line: int) -> range:
        """Show a line, and hand it over."""
        if line not in self._records.missing:
            self._watch(line, self.buffer(line), self._records)
        if self._period_ns:
            await sleep_until_ns((self._last_ns or now_ns()) + self._period_ns)
            self._last_ns = now_ns()
        return await self._sink.append(line)

    async def flush(self) -> range:
        """Store whatever is still in memory."""
        return await self._sink.flush()

    async def close(self) -> None:
        """Close the output. Idempotent."""
        await self._sink.close()
