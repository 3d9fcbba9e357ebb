"""Processing beside a scan makes what `process` makes of the finished cube, and nothing that befalls it touches the scan."""

import asyncio
import threading
import time
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import scanhsi
from processing.test_process import spec, steps, write
from scanhsi import clock
from scanhsi.calibration.reference import average
from scanhsi.cube.reader import cube_summary, open_cube, read_records
from scanhsi.cube.records import LineRecords
from scanhsi.cube.writer import CubeWriter
from scanhsi.devices.errors import CalibrationError, ConfigError, CubeExists, ScanFailed
from scanhsi.instrument import load_instrument
from scanhsi.processing import BinBands, LiveProcessing, MaskSaturated, Reflectance, SubtractDark, follow, process
from support.cubes import feed

LINES = 45


@pytest.fixture
def references(tmp_path):
    rng = np.random.default_rng(1)
    write(tmp_path / "dark.zarr", spec(8), 60 + rng.integers(0, 9, (23, 8, 40)))
    write(tmp_path / "white.zarr", spec(8), 3000 + rng.integers(0, 99, (23, 8, 40)))
    return tmp_path


async def grow(path: Path, stages: list[range], reached: list[threading.Event], go_on: list[threading.Event]) -> None:
    """Write a cube in stages, each when it is told to; close it."""
    records, what = LineRecords(LINES), spec(LINES)
    writer = CubeWriter(path, what, lines_per_shard=8)
    await writer.open(records)
    for stage, there, on in zip(stages, reached, go_on, strict=True):
        await feed(writer, what, records, stage, {20: "lost"})
        while records.stored + len(records.missing) < stage.stop // 8 * 8:
            await asyncio.sleep(0.01)
        there.set()
        assert await asyncio.to_thread(on.wait, 30)
    await writer.flush()
    await writer.close()


def same_cubes(first: Path, second: Path) -> None:
    one, other = open_cube(first), open_cube(second)
    xr.testing.assert_identical(one.drop_attrs(deep=False), other.drop_attrs(deep=False))
    assert one.attrs == other.attrs
    np.testing.assert_array_equal(read_records(first).stamps["stored"], read_records(second).stamps["stored"])


@pytest.mark.parametrize("until", [21])
def test_a_cube_that_grows_is_processed_as_it_grows_and_as_if_afterwards(references, until):
    raw, out = references / "hand.zarr", references / "live.zarr"
    reached, go_on = [threading.Event() for _ in range(2)], [threading.Event() for _ in range(2)]
    stages = [range(10), range(10, until)]
    scan = threading.Thread(target=lambda: asyncio.run(grow(raw, stages, reached, go_on)))
    scan.start()
    made: list[int] = []
    got_to = threading.Event()

    def progress(done: int, total: int) -> None:
        assert total == LINES
        made.append(done)
        if done == until // 8 * 8:
            got_to.set()

    result = []
    chain = steps(references)

    def run() -> None:
        result.append(follow(raw, out, chain, over=lambda: not scan.is_alive(), progress=progress))

    beside = threading.Thread(target=run)
    beside.start()
    assert reached[0].wait(30)
    while made != [8]:
        time.sleep(0.01)
    half = cube_summary(out)
    assert (half.complete, half.shape[1]) == (False, 8)
    go_on[0].set()
    assert got_to.wait(30)
    go_on[1].set()
    for thread in (scan, beside):
        thread.join(30)
    assert result[0].lines == until
    assert result[0].behind == until % 8
    process(raw, references / "after.zarr", steps(references))
    same_cubes(out, references / "after.zarr")
    assert cube_summary(out).complete == (until == LINES)


def test_what_ended_in_the_middle_goes_on_when_the_scan_is_resumed(references):
    raw, out = references / "hand.zarr", references / "live.zarr"

    async def some(reach: int) -> None:
        what, records = spec(LINES), LineRecords(LINES)
        writer = CubeWriter.resume(raw, what) if raw.exists() else CubeWriter(raw, what, lines_per_shard=8)
        first = writer.next_line
        await writer.open(records)
        await feed(writer, what, records, range(first, reach), {20: "lost"})
        await writer.close()

    asyncio.run(some(21))
    assert follow(raw, out, steps(references)).lines == 21
    assert not cube_summary(out).complete
    asyncio.run(some(LINES))
    with pytest.raises(CubeExists):
        follow(raw, out, steps(references))
    process(raw, out, steps(references), resume=True)
    process(raw, references / "after.zarr", steps(references))
    same_cubes(out, references / "after.zarr")


INSTRUMENT = {"roi.bands": 60, "roi.samples": 80}


@pytest.fixture(scope="module")
def instrument(tmp_path_factory):
    """A scan with its references, and the chain."""
    folder = tmp_path_factory.mktemp("live")
    for scene in ("dark", "white"):
        scan(folder / f"{scene}.zarr", scene, lines=8)
    dark, white = average(folder / "dark.zarr"), average(folder / "white.zarr")
    return folder, [MaskSaturated(), SubtractDark(dark), Reflectance(white, dark, tile=0.99), BinBands(5)]


def scan(path: Path | None, scene: str = "hand", *, lines: int = 100, live: LiveProcessing | None = None):
    async def main():
        async with scanhsi.open_instrument(
            load_instrument("sensors2019", {"camera.scene": scene, **INSTRUMENT})
        ) as hsi:
            return await hsi.scan(hsi.default_plan(lines=lines, exposure="20 ms"), path, process=live)

    return clock.run(main(), virtual=True)


def test_a_scan_makes_its_reflectance(instrument, tmp_path):
    _, chain = instrument
    report = scan(tmp_path / "raw.zarr", live=LiveProcessing(chain, tmp_path / "live.zarr"))
    assert report.stored == 100
    assert report.processed is not None
    assert report.processed.error is None
    assert report.processed.lines == 100
    process(tmp_path / "raw.zarr", tmp_path / "after.zarr", chain)
    same_cubes(tmp_path / "live.zarr", tmp_path / "after.zarr")
    assert open_cube(tmp_path / "live.zarr").attrs["processing"][0]["step"] == "read"


def breaks():
    """A step that fails on every line, defined where another process cannot import it."""

    class Breaks:
        name = "breaks"

        def bind(self, signal):
            return signal, lambda lines: lines / np.zeros(3)

        def describe(self):
            return {}

    return Breaks()


def test_what_fails_beside_a_scan_is_told_and_costs_it_nothing(instrument, tmp_path, caplog):
    report = scan(tmp_path / "raw.zarr", live=LiveProcessing([breaks()], tmp_path / "live.zarr"))
    assert report.stored == 100
    assert report.processed is not None
    assert "broadcast" in (report.processed.error or "")
    assert "live processing failed" in caplog.text
    assert cube_summary(tmp_path / "raw.zarr").complete
    assert not cube_summary(tmp_path / "live.zarr").complete
    with pytest.raises(CubeExists):
        process(tmp_path / "raw.zarr", tmp_path / "live.zarr", instrument[1])


def test_what_cannot_be_is_refused_before_anything_moves(instrument, tmp_path):
    folder, chain = instrument
    with pytest.raises(ConfigError, match="discarded"):
        scan(None, live=LiveProcessing(chain, tmp_path / "live.zarr"))
    with pytest.raises(CubeExists):
        scan(tmp_path / "raw.zarr", live=LiveProcessing(chain, folder / "dark.zarr"))
    with pytest.raises(CalibrationError, match="cannot be binned"):
        scan(tmp_path / "raw.zarr", live=LiveProcessing([BinBands(99)], tmp_path / "live.zarr"))
    assert not list(tmp_path.iterdir())


def test_a_scan_that_is_cancelled_ends_it_and_what_was_made_stays(instrument, tmp_path):
    async def main():
        async with scanhsi.open_instrument(load_instrument("sensors2019", INSTRUMENT)) as hsi:
            scanning = asyncio.ensure_future(
                hsi.scan(
                    hsi.default_plan(lines=400, exposure="20 ms"),
                    tmp_path / "raw.zarr",
                    process=LiveProcessing(instrument[1], tmp_path / "live.zarr"),
                )
            )
            while not (tmp_path / "raw.zarr" / "status" / "c" / "0").exists():
                await asyncio.sleep(0.1)
            scanning.cancel()
            await scanning

    with pytest.raises((asyncio.CancelledError, ScanFailed)):
        clock.run(main(), virtual=True)
    process(tmp_path / "raw.zarr", tmp_path / "live.zarr", instrument[1], resume=True)
    assert cube_summary(tmp_path / "live.zarr").lines_stored == cube_summary(tmp_path / "raw.zarr").lines_stored


def test_shards_of_the_raw_cube_may_be_larger_than_those_of_the_new_one(references):
    what = spec(200)

    async def main() -> None:
        writer = CubeWriter(references / "large.zarr", what, lines_per_shard=100)
        records = LineRecords(200)
        await writer.open(records)
        await feed(writer, what, records, range(200), {})
        await writer.close()

    asyncio.run(main())
    told: list[int] = []
    turns = iter(range(12))
    done = follow(
        references / "large.zarr",
        references / "out.zarr",
        steps(references),
        over=lambda: next(turns, None) is None,
        progress=lambda lines, _: told.append(lines),
    )
    assert told == [64, 128, 192]
    assert (done.lines, done.behind) == (200, 8)
    process(references / "large.zarr", references / "after.zarr", steps(references))
    same_cubes(references / "out.zarr", references / "after.zarr")
