import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from scanhsi import clock
from scanhsi.cube import repack as repacking
from scanhsi.cube.layout import CubeSpec
from scanhsi.cube.quicklook import QuicklookSpec
from scanhsi.cube.reader import cube_summary, open_cube, read_records
from scanhsi.cube.records import STAGES, LineRecords
from scanhsi.cube.repack import repack
from scanhsi.cube.writer import CubeWriter
from scanhsi.devices.errors import CubeError, CubeExists, NotACube
from support.cubes import feed, whole

SPEC = CubeSpec(
    lines=53,
    bands=12,
    samples=30,
    dtype=np.uint16,
    significant_bits=12,
    attributes={"run": "a", "plan": {"exposure_s": 0.02}, "simulated": True},
    wavelength_nm=np.linspace(400, 900, 12),
    quicklook=QuicklookSpec(np.ones((3, 12)) / 12, ("red", "green", "blue"), "test"),
)


def write(path: Path, *, reach: int = 53, codec: str = "raw", missing: dict[int, str] | None = None) -> LineRecords:
    async def main() -> LineRecords:
        records = LineRecords(SPEC.lines)
        writer = CubeWriter(path, SPEC, lines_per_shard=8, codec=codec)
        await writer.open(records)
        await feed(writer, SPEC, records, range(reach), {11: "lost", 30: "lost too"} if missing is None else missing)
        await writer.flush()
        await writer.close()
        return records

    return clock.run(main(), virtual=True)


def same(path: Path, records: LineRecords, lines: int = 53) -> None:
    dataset = open_cube(path)
    good = dataset["status"].values == 1
    np.testing.assert_array_equal(dataset["cube"].values[:, good], whole(SPEC, lines)[:, good])
    assert np.flatnonzero(~good).tolist() == [line for line in (11, 30) if line < lines]
    again = read_records(path)
    assert again.missing == {line: reason for line, reason in {11: "lost", 30: "lost too"}.items() if line < lines}
    np.testing.assert_array_equal(again.mirror_step, records.mirror_step[:lines])
    np.testing.assert_array_equal(again.smeared, records.smeared[:lines])
    for stage in STAGES:
        np.testing.assert_array_equal(again.stamps[stage], records.stamps[stage][:lines])


@pytest.mark.parametrize("codec", ["lz4", "zstd", "none", "raw"])
@pytest.mark.parametrize("reach", [53, 37])
def test_a_repacked_cube_is_the_same_cube(tmp_path, codec, reach):
    path = tmp_path / "a.zarr"
    records = write(path, reach=reach)
    before, old = cube_summary(path), open_cube(path)["quicklook"].values
    told = []
    result = repack(path, codec=codec, progress=lambda done, total: told.append(done / total))
    same(path, records, reach)
    after = cube_summary(path)
    assert result.replaced
    assert (after.complete, after.lines_planned, after.wavelength_nm) == (before.complete, 53, before.wavelength_nm)
    assert after.attributes["acquisition"] == before.attributes["acquisition"]
    assert after.attributes["plan"] == before.attributes["plan"]
    assert after.attributes["storage"]["codec"] == codec
    np.testing.assert_array_equal(open_cube(path)["quicklook"].values, old)
    assert max(told) == told[-1] == 1
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.zarr"]


def test_the_old_cube_stays_where_another_name_is_given(tmp_path):
    records = write(tmp_path / "a.zarr")
    result = repack(tmp_path / "a.zarr", tmp_path / "b.zarr")
    assert not result.replaced
    assert result.bytes_after < result.bytes_before
    same(tmp_path / "a.zarr", records)
    same(tmp_path / "b.zarr", records)
    with pytest.raises(CubeExists, match=r"b\.zarr"):
        repack(tmp_path / "a.zarr", tmp_path / "b.zarr")


def test_a_shard_that_does_not_read_back_leaves_the_old_cube(tmp_path, monkeypatch):
    from scanhsi.cube.durable import LocalDestination

    records = write(tmp_path / "a.zarr")
    put = LocalDestination.put

    def bad_disk(self, key, parts, *, durable):
        if key == "cube/c/0/2/0":
            parts = [memoryview(bytearray(part)) for part in parts]
            parts[0][7] ^= 1
        put(self, key, parts, durable=durable)

    with monkeypatch.context() as patch:
        patch.setattr(LocalDestination, "put", bad_disk)
        with pytest.raises(Exception, match=r"read back|checksum|Checksum|crc"):
            repack(tmp_path / "a.zarr", codec="none")
    same(tmp_path / "a.zarr", records)
    repack(tmp_path / "a.zarr", codec="none")
    same(tmp_path / "a.zarr", records)


KILLED = """
import os, signal, sys
from scanhsi.cube import durable
from scanhsi.cube.repack import repack
calls, deadly = 0, int(sys.argv[2])
def counting(name, function):
    def counted(*args, **kwargs):
        global calls
        calls += 1
        if calls == deadly:
            os.kill(os.getpid(), signal.SIGKILL)
        return function(*args, **kwargs)
    return counted
for name in ("rename", "replace", "fsync", "fdatasync", "unlink", "rmdir"):
    setattr(os, name, counting(name, getattr(os, name)))
repack(sys.argv[1])
print(calls)
"""


def test_killed_at_any_call_the_cube_is_there_after_the_next_try(tmp_path):
    """Between any two calls that change the disk: the old cube, or the new one, is whole, or the next call makes it so."""
    counting = subprocess.run(
        [sys.executable, "-c", KILLED, str(prepared(tmp_path / "count")), "0"],
        capture_output=True,
        text=True,
        check=True,
    )
    calls = int(counting.stdout)
    assert calls > 60
    moments = sorted({*np.linspace(1, calls - 30, 3, dtype=int).tolist(), *range(calls - 28, calls, 9)})
    killed = 0
    for moment in moments:
        path = prepared(tmp_path / str(moment))
        ended = subprocess.run([sys.executable, "-c", KILLED, str(path), str(moment)], capture_output=True, check=False)
        assert ended.returncode in (-signal.SIGKILL, 0)  # syncs that fall together are fewer: then it has ended before
        killed += ended.returncode != 0
        if ended.returncode:
            repack(path)
        same(path, RECORDS[path])
        assert [entry.name for entry in path.parent.iterdir()] == ["a.zarr"]
    assert killed >= len(moments) - 2


RECORDS: dict[Path, LineRecords] = {}


def prepared(folder: Path) -> Path:
    folder.mkdir()
    RECORDS[folder / "a.zarr"] = write(folder / "a.zarr")
    return folder / "a.zarr"


def test_what_cannot_be_repacked_is_refused(tmp_path):
    with pytest.raises(NotACube):
        repack(tmp_path / "nothing.zarr")
    write(tmp_path / "empty.zarr", reach=0)
    with pytest.raises(CubeError, match="holds no line"):
        repack(tmp_path / "empty.zarr")
    assert repacking.__doc__
    assert os.listdir(tmp_path) == ["empty.zarr"]
