"""What every `LineSink` must do, as a class to inherit from.

::

    class TestMine(SinkContract):
        @pytest.fixture
        def sink(self) -> LineSink: ...           # not opened yet, for `SinkContract.spec`
        stores = True                             # whether lines end as STORED
"""

from __future__ import annotations

import asyncio

import numpy as np
import pytest

from scanhsi import clock
from scanhsi.cube.layout import CubeSpec
from scanhsi.cube.records import NOT_STAMPED, LineRecords, LineStatus
from scanhsi.cube.sink import LineSink
from support.cubes import feed, frame, take_line


class SinkContract:
    """Inherit, and give a ``sink`` fixture."""

    spec = CubeSpec(23, 5, 6, "uint16", 12)
    stores = True

    @pytest.fixture
    def sink(self) -> LineSink:
        raise NotImplementedError

    def test_each_line_is_named_once_in_order(self, sink: LineSink) -> None:
        missing = {3: "lost", 4: "lost", 22: "lost"}

        async def main() -> LineRecords:
            records = LineRecords(self.spec.lines)
            await sink.open(records)
            named: list[int] = []
            for line in range(self.spec.lines):
                returned = await feed(sink, self.spec, records, range(line, line + 1), missing)
                named += [safe for safe_range in returned for safe in safe_range]
                assert all(records.status[safe] != LineStatus.NOT_STORED or not self.stores for safe in named)
                assert line + 1 - len(named) <= sink.capacity
            named += list(await sink.flush())
            await sink.close()
            assert named == list(range(self.spec.lines))
            return records

        records = clock.run(main(), virtual=True)
        kept = LineStatus.STORED if self.stores else LineStatus.NOT_STORED
        expected = [LineStatus.MISSING if line in missing else kept for line in range(self.spec.lines)]
        np.testing.assert_array_equal(records.status, expected)
        stamped = records.stamps["stored"] != NOT_STAMPED
        assert [line for line in range(self.spec.lines) if not stamped[line]] == list(missing)

    def test_buffers_in_flight_do_not_overlap(self, sink: LineSink) -> None:
        """As many lines as the credits allow may be filled before the first is appended."""

        async def main() -> None:
            records = LineRecords(self.spec.lines)
            await sink.open(records)
            ahead = min(sink.capacity, self.spec.lines)
            buffers = [sink.buffer(line) for line in range(ahead)]
            for line, buffer in enumerate(buffers):
                if buffer is not None:
                    assert buffer.shape == (self.spec.bands, self.spec.samples)
                    assert buffer.dtype == self.spec.dtype
                    buffer[:] = frame(self.spec, line)
            for line, buffer in enumerate(buffers):
                if buffer is not None:
                    np.testing.assert_array_equal(buffer, frame(self.spec, line))
                take_line(records, line)
                await sink.append(line)
            await sink.close()

        clock.run(main(), virtual=True)

    @pytest.mark.parametrize("reach", [0, 1, 9])
    def test_close_without_flush_keeps_what_was_appended(self, sink: LineSink, reach: int) -> None:
        async def main() -> LineRecords:
            records = LineRecords(self.spec.lines)
            await sink.open(records)
            await feed(sink, self.spec, records, range(reach), {})
            await sink.close()
            await sink.close()
            return records

        records = clock.run(main(), virtual=True)
        assert records.stored == (reach if self.stores else 0)

    def test_close_before_open_does_nothing(self, sink: LineSink) -> None:
        clock.run(sink.close(), virtual=True)

    @pytest.mark.parametrize("cancel_at", [None, 0, 3, 7, 8, 11, 22])
    def test_cancelled_task_can_close(self, sink: LineSink, cancel_at: int | None) -> None:
        """Cancelled in ``open`` (None) or at the next await after a line: close works, and nothing appended is lost."""

        async def scan(records: LineRecords) -> None:
            me = asyncio.current_task()
            assert me is not None
            try:
                if cancel_at is None:
                    me.cancel()
                await sink.open(records)
                for line in range(self.spec.lines):
                    if line == cancel_at:
                        me.cancel()
                    await feed(sink, self.spec, records, range(line, line + 1), {})
                await asyncio.sleep(0)  # where the cancellation lands at the latest
            finally:
                await sink.close()

        async def main() -> LineRecords:
            records = LineRecords(self.spec.lines)
            await asyncio.wait([asyncio.create_task(scan(records))])
            return records

        records = clock.run(main(), virtual=True)
        taken = int(np.count_nonzero(records.stamps["copied"] != NOT_STAMPED))
        assert taken >= (0 if cancel_at is None else cancel_at + 1)
        assert records.stored == (taken if self.stores else 0)
