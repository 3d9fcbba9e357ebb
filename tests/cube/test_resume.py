"""An interrupted cube goes on where it ended: bit-exact, with its records, whatever interrupted it."""

from __future__ import annotations

import errno
import itertools
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scanhsi import clock
from scanhsi.cube import durable
from scanhsi.cube.binning import Binning
from scanhsi.cube.layout import CubeSpec
from scanhsi.cube.quicklook import QuicklookSpec
from scanhsi.cube.reader import cube_summary, open_cube, read_records
from scanhsi.cube.records import STAGES, LineRecords
from scanhsi.cube.writer import CubeWriter
from scanhsi.devices.errors import CubeError, NotACube
from support.cubes import feed, write_cube

ATTRIBUTES = {"plan": {"lines": 23}, "run": "first"}
SPEC = CubeSpec(
    23, 5, 18, "uint16", 12, ATTRIBUTES, np.linspace(400, 800, 5), quicklook=QuicklookSpec(np.ones((3, 5)) / 5)
)
MISSING = {2: "lost", 9: "late", 21: "lost"}
OFFSET_NS = 1_000_000


@pytest.fixture(autouse=True)
def unsynced() -> Iterator[None]:
    """What is synced is the affair of other tests; here it only takes time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(durable.os, "fsync", lambda _: None)
        yield


async def go_on(path: Path, spec: CubeSpec, reach: int, offset_ns: int = OFFSET_NS) -> LineRecords:
    writer = CubeWriter.resume(path, spec, clock_offset_ns=offset_ns)
    records = LineRecords(spec.lines)
    await writer.open(records)
    try:
        await feed(writer, spec, records, range(writer.next_line, reach), MISSING)
        await writer.flush()
    finally:
        await writer.close()
    return records


async def begin(path: Path, spec: CubeSpec, reach: int, **how: Any) -> None:
    writer = CubeWriter(path, spec, clock_offset_ns=OFFSET_NS, **how)
    records = LineRecords(spec.lines)
    await writer.open(records)
    try:
        await feed(writer, spec, records, range(reach), MISSING)
    finally:
        await writer.close()


def files_of(path: Path) -> dict[str, bytes]:
    return {str(file.relative_to(path)): file.read_bytes() for file in path.rglob("*") if file.is_file()}


def chunks_of(path: Path) -> dict[str, bytes]:
    return {name: contents for name, contents in files_of(path).items() if not name.endswith("zarr.json")}


def test_any_stop_ends_in_the_same_files(tmp_path: Path) -> None:
    """Closed at any line, twice: pixels, records, picture and status are, byte for byte, those of a scan in one piece."""
    whole = tmp_path / "whole.zarr"
    clock.run(begin(whole, SPEC, SPEC.lines, lines_per_shard=8), virtual=True)
    for stops in itertools.chain(((stop,) for stop in range(0, 24, 3)), [(8, 8), (3, 5), (11, 20), (0, 22)]):
        path = tmp_path / "cube.zarr"
        clock.run(begin(path, SPEC, stops[0], lines_per_shard=8), virtual=True)
        for stop in (*stops[1:], SPEC.lines):
            assert not cube_summary(path).complete
            clock.run(go_on(path, SPEC, stop), virtual=True)
        expected = chunks_of(whole)
        there = chunks_of(path)
        stamped = {name for name in expected if name.startswith(("stored_ns/", "run/"))}  # and no others may differ
        assert {name: there[name] for name in expected.keys() - stamped} == {
            name: expected[name] for name in expected.keys() - stamped
        }
        assert there.keys() == expected.keys()
        assert cube_summary(path).missing_reasons == MISSING
        assert cube_summary(path).complete
        assert len(open_cube(path).attrs["resumed"]) == len(stops)
        shutil.rmtree(path)


@settings(max_examples=8, deadline=None)
@given(
    codec=st.sampled_from(["lz4", "zstd", "none", "raw"]),
    durability=st.sampled_from(["every shard", "at close"]),
    binning=st.sampled_from([Binning(), Binning(2, 1), Binning(1, 3), Binning(5, 6)]),
    per_shard=st.integers(1, 24),
    stop=st.integers(0, 22),
)
def test_every_way_to_store(codec: Any, durability: Any, binning: Binning, per_shard: int, stop: int) -> None:
    import tempfile

    folder = Path(tempfile.mkdtemp())
    spec = replace(SPEC, binning=binning)
    how = {"codec": codec, "durability": durability, "lines_per_shard": per_shard}
    try:
        clock.run(begin(folder / "whole", spec, spec.lines, **how), virtual=True)
        clock.run(begin(folder / "cube", spec, stop, **how), virtual=True)
        clock.run(go_on(folder / "cube", spec, spec.lines), virtual=True)
        for name in ("cube", "status", "mirror_step", "quicklook"):
            np.testing.assert_array_equal(
                open_group(folder / "cube", name), open_group(folder / "whole", name), err_msg=name
            )
    finally:
        shutil.rmtree(folder)


def open_group(path: Path, name: str) -> Any:
    import zarr

    return np.asarray(zarr.open_group(path, mode="r")[name][:])  # pyright: ignore[reportIndexIssue]


@pytest.mark.parametrize("codec", ["lz4", "raw"])
def test_died_between_any_two_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, codec: Any) -> None:
    """Whatever file was the last one: what was stored stays as it was, and the cube is completed."""
    give_name = durable.give_name
    path = tmp_path / "cube.zarr"
    for count in range(40, 140, 5):
        left = [count]

        def name_or_die(temporary: Path, path: Path, left: list[int] = left) -> None:
            left[0] -= 1
            if left[0] < 0:
                raise OSError(errno.ENOSPC, "full")
            give_name(temporary, path)

        with monkeypatch.context() as patch:
            patch.setattr(durable, "give_name", name_or_die)
            with pytest.raises(CubeError, match="is full"):
                clock.run(begin(path, SPEC, SPEC.lines, lines_per_shard=4, codec=codec), virtual=True)
        before = read_records(path)
        reached = before.lines
        records = clock.run(go_on(path, SPEC, SPEC.lines), virtual=True)
        np.testing.assert_array_equal(before.stamps["stored"], records.stamps["stored"][:reached])
        np.testing.assert_array_equal(
            open_group(path, "cube"), np.where(records.status[:, None, None] == 2, 0, frames()).transpose(1, 0, 2)
        )
        assert records.missing == MISSING
        shutil.rmtree(path)


def frames() -> Any:
    """(line, band, sample) of SPEC."""
    from support.cubes import frame

    return np.stack([frame(SPEC, line) for line in range(SPEC.lines)])


def test_stamps_stay_on_the_first_sessions_clock(tmp_path: Path) -> None:
    path = tmp_path / "cube.zarr"
    clock.run(begin(path, SPEC, 6, lines_per_shard=4), virtual=True)
    clock.run(go_on(path, SPEC, SPEC.lines, offset_ns=OFFSET_NS + 777), virtual=True)
    dataset = open_cube(path)
    for stage in set(STAGES) - {"stored", "first_byte"}:
        number = STAGES.index(stage)
        column = dataset[f"{stage}_ns"].values
        assert column[5] == 5_000_000 + number
        assert column[22] == 22_000_000 + number + 777
    time = dataset["time"].values.astype("int64")
    start = dataset["exposure_start_ns"].values
    there = dataset["status"].values == 1
    np.testing.assert_array_equal((time - start)[there], OFFSET_NS)
    assert dataset.attrs["clock_offset_ns"] == OFFSET_NS


def test_records_of_the_lines_there_are_filled(tmp_path: Path) -> None:
    path = tmp_path / "cube.zarr"
    clock.run(begin(path, SPEC, 10, lines_per_shard=4), virtual=True)
    before = read_records(path)

    async def main() -> None:
        writer = CubeWriter.resume(path, SPEC, clock_offset_ns=OFFSET_NS + 50)
        assert writer.next_line == 10
        records = LineRecords(SPEC.lines)
        await writer.open(records)
        assert records.missing == {2: "lost", 9: "late"}
        np.testing.assert_array_equal(records.status[:10], before.status)
        np.testing.assert_array_equal(records.mirror_step[:10], before.mirror_step)
        assert records.stamps["copied"][3] == before.stamps["copied"][3] - 50  # on the loop's clock
        assert not records.status[10:].any()
        with pytest.raises(RuntimeError, match="the next one is 10"):
            await writer.append(0)
        await writer.close()

    clock.run(main(), virtual=True)
    np.testing.assert_array_equal(read_records(path).stamps["copied"], before.stamps["copied"])


def test_all_lines_there_but_not_closed(tmp_path: Path) -> None:
    path = tmp_path / "cube.zarr"
    clock.run(begin(path, SPEC, SPEC.lines, lines_per_shard=4), virtual=True)
    root = path / "zarr.json"
    root.write_text(root.read_text().replace('"complete": true', '"complete": false'))
    clock.run(go_on(path, SPEC, SPEC.lines), virtual=True)
    assert cube_summary(path).complete


def test_leftovers_of_the_dead_are_removed(tmp_path: Path) -> None:
    path = tmp_path / "cube.zarr"
    clock.run(begin(path, SPEC, 6, lines_per_shard=4), virtual=True)
    (path / "cube/c/0/1/.0.abc.partial").write_bytes(b"half")
    (path / "status/c/.1.abc.partial").write_bytes(b"half")
    clock.run(go_on(path, SPEC, SPEC.lines), virtual=True)
    assert not [name for name in files_of(path) if name.endswith(".partial")]


REFUSED = {
    "another 'plan'": (replace(SPEC, attributes={"plan": {"lines": 5}}), r"attribute 'plan'.*\{'lines': 23\} there"),
    "lines": (replace(SPEC, lines=24), "another lines: 23 there, 24 now"),
    "bits": (replace(SPEC, significant_bits=13), "another significant bits"),
    "binned": (replace(SPEC, binning=Binning(2)), "another .*binning"),
    "wavelengths": (replace(SPEC, wavelength_nm=None), "wavelengths"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_another_scan_is_refused(tmp_path: Path, case: str) -> None:
    path = tmp_path / "cube.zarr"
    clock.run(begin(path, SPEC, 6, lines_per_shard=4), virtual=True)
    before = files_of(path)
    spec, text = REFUSED[case]
    with pytest.raises(CubeError, match=text):
        CubeWriter.resume(path, spec)
    assert files_of(path) == before
    CubeWriter.resume(path, replace(SPEC, attributes={**ATTRIBUTES, "run": "second"}))


def test_what_cannot_be_resumed(tmp_path: Path) -> None:
    path = tmp_path / "cube.zarr"
    with pytest.raises(NotACube, match="no cube"):
        CubeWriter.resume(path, SPEC)
    (tmp_path / "folder").mkdir()
    with pytest.raises(NotACube, match="no cube"):
        CubeWriter.resume(tmp_path / "folder", SPEC)
    spec = CubeSpec(4, 2, 2, "uint8", 8)
    clock.run(write_cube(path, spec, lines_per_shard=2), virtual=True)
    with pytest.raises(CubeError, match="is complete"):
        CubeWriter.resume(path, spec)


def test_a_hole_is_not_written_over(tmp_path: Path) -> None:
    path = tmp_path / "cube.zarr"
    clock.run(begin(path, SPEC, 12, lines_per_shard=4), virtual=True)
    (path / "status/c/1").unlink()
    with pytest.raises(CubeError, match="no line 4, but lines behind it, up to 11"):
        CubeWriter.resume(path, SPEC)


def test_damage_is_told(tmp_path: Path) -> None:
    path = tmp_path / "cube.zarr"
    clock.run(begin(path, SPEC, 6, lines_per_shard=4, codec="none"), virtual=True)
    shard = path / "cube/c/0/1/0"
    contents = bytearray(shard.read_bytes())
    contents[3] ^= 1
    shard.write_bytes(contents)
    before = files_of(path)
    with pytest.raises(CubeError, match=r"cube/c/0/1/0 of .* is damaged"):
        clock.run(go_on(path, SPEC, SPEC.lines), virtual=True)
    assert files_of(path) == before
    with pytest.raises(CubeError, match=r"cube/c/0/1/0 of .* is damaged"):  # and the lock is free again
        clock.run(go_on(path, SPEC, SPEC.lines), virtual=True)


def test_only_one_writes(tmp_path: Path) -> None:
    path = tmp_path / "cube.zarr"

    async def main() -> None:
        writer = CubeWriter(path, SPEC, lines_per_shard=4)
        await writer.open(LineRecords(SPEC.lines))
        with pytest.raises(CubeError, match="being written by another process"):
            CubeWriter.resume(path, SPEC)
        await writer.close()
        second = CubeWriter.resume(path, SPEC)
        with pytest.raises(CubeError, match="being written by another process"):
            CubeWriter.resume(path, SPEC)
        await second.close()  # never opened: lets others in
        await CubeWriter.resume(path, SPEC).close()

    clock.run(main(), virtual=True)
