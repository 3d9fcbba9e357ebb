"""Both sinks keep the contract; and what the contract does not say but the writer promises."""

from __future__ import annotations

import asyncio
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scanhsi import clock
from scanhsi.cube import durable
from scanhsi.cube.binning import Binning
from scanhsi.cube.layout import CubeSpec
from scanhsi.cube.quicklook import QuicklookSpec
from scanhsi.cube.reader import open_cube
from scanhsi.cube.records import LineRecords
from scanhsi.cube.shards import CubeFiles, ShardPixels
from scanhsi.cube.sink import DiscardSink, LineSink
from scanhsi.cube.slow import SlowSink
from scanhsi.cube.writer import CubeWriter
from support.cubes import feed, frame, whole
from support.sink_contract import SinkContract

SPEC = CubeSpec(23, 5, 6, "uint16", 12)


@pytest.fixture(autouse=True)
def unsynced(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is synced, and when, is the affair of test_crash; here it only takes time."""
    monkeypatch.setattr(durable.os, "fsync", lambda _: None)


class TestDiscardSink(SinkContract):
    stores = False

    @pytest.fixture
    def sink(self) -> LineSink:
        return DiscardSink()


class TestCubeWriter(SinkContract):
    @pytest.fixture(
        params=[(2, "lz4", "every shard"), (3, "lz4", "at close"), (3, "zstd", "every shard"), (2, "none", "at close")]
    )
    def sink(self, tmp_path: Path, request: pytest.FixtureRequest) -> LineSink:
        slots, codec, durability = request.param
        return CubeWriter(
            tmp_path / "cube.zarr", self.spec, slots=slots, lines_per_shard=4, codec=codec, durability=durability
        )


class TestRawCubeWriter(SinkContract):
    @pytest.fixture(params=["every shard", "at close"])
    def sink(self, tmp_path: Path, request: pytest.FixtureRequest) -> LineSink:
        return CubeWriter(tmp_path / "cube.zarr", self.spec, lines_per_shard=4, codec="raw", durability=request.param)


class TestBinningCubeWriter(SinkContract):
    spec = CubeSpec(23, 5, 6, "uint16", 12, binning=Binning(2, 3), quicklook=QuicklookSpec(np.full((3, 5), 0.2)))

    @pytest.fixture(params=["lz4", "raw"])
    def sink(self, tmp_path: Path, request: pytest.FixtureRequest) -> LineSink:
        return CubeWriter(tmp_path / "cube.zarr", self.spec, slots=2, lines_per_shard=4, codec=request.param)


class TestResumedCubeWriter(SinkContract):
    """A cube of which nothing is there yet goes on as a new one."""

    @pytest.fixture(params=["lz4", "raw"])
    def sink(self, tmp_path: Path, request: pytest.FixtureRequest) -> LineSink:
        async def begin() -> None:
            writer = CubeWriter(tmp_path / "cube.zarr", self.spec, lines_per_shard=4, codec=request.param)
            await writer.open(LineRecords(self.spec.lines))
            await writer.close()

        clock.run(begin(), virtual=True)
        return CubeWriter.resume(tmp_path / "cube.zarr", self.spec)


class TestSlowSink(SinkContract):
    @pytest.fixture
    def sink(self, tmp_path: Path) -> LineSink:
        writer = CubeWriter(tmp_path / "cube.zarr", self.spec, slots=2, lines_per_shard=4)
        return SlowSink(writer, lambda line: 1_000_000 * (line % 3))


@pytest.fixture
def held_disk(monkeypatch: pytest.MonkeyPatch) -> threading.Event:
    """Shards do not reach the disk until this is set."""
    gate = threading.Event()
    write = CubeFiles.write_pixels

    def wait_and_write(self: CubeFiles, pixels: ShardPixels) -> Any:
        gate.wait(30)
        return write(self, pixels)

    monkeypatch.setattr(CubeFiles, "write_pixels", wait_and_write)
    return gate


def test_a_slow_disk_holds_append_back_and_buffers_stay_owned(tmp_path: Path, held_disk: threading.Event) -> None:
    async def main() -> None:
        records = LineRecords(SPEC.lines)
        writer = CubeWriter(tmp_path / "cube.zarr", SPEC, slots=2, lines_per_shard=4)
        await writer.open(records)
        await feed(writer, SPEC, records, range(7), {})
        writer.buffer(7)[:] = frame(SPEC, 7)  # pyright: ignore[reportOptionalSubscript]
        last = asyncio.create_task(writer.append(7))
        await asyncio.sleep(0.05)
        assert not last.done()  # both slots are full
        with pytest.raises(RuntimeError, match="only 8 may be in flight"):
            writer.buffer(8)
        held_disk.set()
        assert (await last).start == 0
        await feed(writer, SPEC, records, range(8, SPEC.lines), {})
        await writer.close()

    clock.run(main())  # real time: virtual time cannot pass while a job runs
    np.testing.assert_array_equal(open_cube(tmp_path / "cube.zarr")["cube"].values, whole(SPEC, SPEC.lines))


def test_cancelled_append_leaves_the_thread_its_buffer(tmp_path: Path, held_disk: threading.Event) -> None:
    """The cancelled line was taken; its shard is written by a thread that nobody awaits any more, and close waits for it."""

    async def main() -> None:
        records = LineRecords(SPEC.lines)
        writer = CubeWriter(tmp_path / "cube.zarr", SPEC, slots=2, lines_per_shard=4)
        await writer.open(records)
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.1):
                await feed(writer, SPEC, records, range(SPEC.lines), {})
        closing = asyncio.create_task(writer.close())
        await asyncio.sleep(0.02)
        closing.cancel()  # even close may be cancelled, and called again
        await asyncio.wait([closing])
        held_disk.set()
        await writer.close()
        assert records.stored == 8

    clock.run(main())
    np.testing.assert_array_equal(open_cube(tmp_path / "cube.zarr")["cube"].values, whole(SPEC, 8))


def test_flush_in_a_pause_then_on(tmp_path: Path) -> None:
    async def main() -> None:
        records = LineRecords(SPEC.lines)
        writer = CubeWriter(tmp_path / "cube.zarr", SPEC, slots=2, lines_per_shard=4)
        await writer.open(records)
        named: list[int] = []
        for start in range(0, SPEC.lines, 5):
            for returned in await feed(
                writer, SPEC, records, range(start, min(start + 5, SPEC.lines)), {start: "lost"}
            ):
                named += returned
            named += await writer.flush()
            assert named == list(range(min(start + 5, SPEC.lines)))
            np.testing.assert_array_equal(
                open_cube(tmp_path / "cube.zarr")["cube"].values[:, start + 1 :],
                whole(SPEC, len(named))[:, start + 1 :],
            )
        await writer.close()

    clock.run(main(), virtual=True)


def test_same_files_in_virtual_time(tmp_path: Path) -> None:
    """Two runs in virtual time write the same bytes, time stamps included."""

    def files(name: str) -> dict[str, bytes]:
        from support.cubes import write_cube

        clock.run(write_cube(tmp_path / name, SPEC, lines_per_shard=4, clock_offset_ns=5), virtual=True)
        root = tmp_path / name
        return {str(file.relative_to(root)): file.read_bytes() for file in root.rglob("*") if file.is_file()}

    assert files("a.zarr") == files("b.zarr")


def test_memory_is_the_slots(tmp_path: Path) -> None:
    spec = CubeSpec(400, 4, 8, "uint8", 8)

    async def main() -> None:
        records = LineRecords(spec.lines)
        writer = CubeWriter(tmp_path / "cube.zarr", spec, slots=3, lines_per_shard=20)
        await writer.open(records)
        addresses: set[int] = set()
        for line in range(spec.lines):
            buffer = writer.buffer(line)
            assert buffer is not None
            addresses.add(buffer.ctypes.data)
            await feed(writer, spec, records, range(line, line + 1), {})
        await writer.close()
        assert len(addresses) == writer.capacity == 60

    clock.run(main(), virtual=True)


def test_misuse_is_refused(tmp_path: Path) -> None:
    async def main() -> None:
        writer = CubeWriter(tmp_path / "cube.zarr", SPEC, lines_per_shard=4)
        with pytest.raises(RuntimeError, match="not open"):
            writer.buffer(0)
        with pytest.raises(ValueError, match="22 lines"):
            await writer.open(LineRecords(22))
        await writer.open(LineRecords(23))
        with pytest.raises(RuntimeError, match="the next one is 0"):
            await writer.append(1)
        await writer.append(0)
        with pytest.raises(RuntimeError, match="the next one is 1"):
            writer.buffer(0)
        with pytest.raises(RuntimeError, match="once"):
            await writer.open(LineRecords(23))
        await writer.close()

    clock.run(main(), virtual=True)
    with pytest.raises(ValueError, match="slots"):
        CubeWriter(tmp_path / "other.zarr", SPEC, slots=1)
