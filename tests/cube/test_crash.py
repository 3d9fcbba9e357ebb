"""Whatever happens while a cube is written, what it says is stored is there."""

from __future__ import annotations

import errno
import json
import os
import random
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from scanhsi import clock
from scanhsi.cube import durable
from scanhsi.cube.layout import CubeSpec
from scanhsi.cube.reader import cube_summary, open_cube, read_records
from scanhsi.cube.records import NOT_STAMPED, LineRecords, LineStatus
from scanhsi.cube.writer import CubeWriter
from scanhsi.devices.errors import CubeError
from support.cubes import feed, frame

SPEC = CubeSpec(11, 5, 6, "uint16", 12)
MISSING = {2: "lost", 9: "late"}


def check_cube(path: Path, spec: CubeSpec) -> int:
    """Every stored line of a cube is exact, with its records; returns how many there are."""
    dataset = open_cube(path)
    records = read_records(path)
    pixels = dataset["cube"].values
    for line, status in enumerate(records.status.tolist()):
        assert status in (LineStatus.STORED, LineStatus.MISSING), "lines become safe in order"
        if status == LineStatus.MISSING:
            assert records.missing[line] != "reason not recorded"
            assert not pixels[:, line].any()
        else:
            np.testing.assert_array_equal(pixels[:, line], frame(spec, line))
            assert records.mirror_step[line] == 100 + 2 * line
            assert records.stamps["stored"][line] != NOT_STAMPED
    return cube_summary(path).lines_stored


@pytest.fixture
def die_at_write(monkeypatch: pytest.MonkeyPatch) -> Callable[[int | None], list[str]]:
    """``die_at_write(n)``: the n-th file that is written, and every later one, is not; returns the names written."""
    give_name = durable.give_name
    monkeypatch.setattr(durable.os, "fsync", lambda _: None)  # only the order matters here, not the disk

    def arm(count: int | None) -> list[str]:
        written: list[str] = []

        def name_or_die(temporary: Path, path: Path) -> None:
            if count is not None and len(written) >= count:
                raise OSError(errno.EIO, "the disk is gone")
            written.append(str(path))
            give_name(temporary, path)

        monkeypatch.setattr(durable, "give_name", name_or_die)
        return written

    return arm


async def feed_and_flush(writer: CubeWriter, records: LineRecords, reach: int = SPEC.lines) -> None:
    await feed(writer, SPEC, records, range(reach), MISSING)
    await writer.flush()


async def scan(path: Path, reach: int = SPEC.lines) -> None:
    records = LineRecords(SPEC.lines)
    writer = CubeWriter(path, SPEC, lines_per_shard=6)
    await writer.open(records)
    await feed_and_flush(writer, records, reach)
    await writer.close()


def scan_and_die(path: Path, count: int, reach: int) -> int | None:
    """Scan until so many files are written, then check what is there; how many lines, or None where nothing is."""
    with pytest.raises(CubeError, match="the disk is gone"):
        clock.run(scan(path, reach), virtual=True)
    stored = check_cube(path, SPEC) if path.exists() else None
    shutil.rmtree(path, ignore_errors=True)
    assert [file.name for file in path.parent.iterdir()] == ["whole.zarr"], count
    return stored


def test_killed_between_any_two_files(tmp_path: Path, die_at_write: Callable[[int | None], list[str]]) -> None:
    written = die_at_write(None)
    clock.run(scan(tmp_path / "whole.zarr"), virtual=True)
    stored: list[int | None] = []
    for count in range(len(written)):
        die_at_write(count)
        stored.append(scan_and_die(tmp_path / "a.zarr", count, SPEC.lines))
    created = stored.index(0)
    assert stored[:created] == [None] * created
    assert list(dict.fromkeys(stored[created:])) == [0, 5, 9]


def test_killed_while_a_short_cube_is_cut(tmp_path: Path, die_at_write: Callable[[int | None], list[str]]) -> None:
    written = die_at_write(None)
    clock.run(scan(tmp_path / "whole.zarr", 5), virtual=True)
    last_status = max(number for number, name in enumerate(written) if "/status/c/" in name)
    assert len(written) - last_status > 16
    for count in range(last_status + 1, len(written)):
        die_at_write(count)
        assert scan_and_die(tmp_path / "a.zarr", count, 5) == 4


def test_status_is_the_last_file_of_a_shard(tmp_path: Path, die_at_write: Callable[[int | None], list[str]]) -> None:
    written = die_at_write(None)
    clock.run(scan(tmp_path / "a.zarr"), virtual=True)
    for shard in range(2):
        files = [name for name in written if name.endswith((f"/c/{shard}", f"/cube/c/0/{shard}/0"))]
        assert files[0].endswith(f"cube/c/0/{shard}/0")
        assert files[-1].endswith(f"status/c/{shard}")
        assert len(files) == 20


def test_every_file_and_its_folders_are_synced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synced: list[str] = []

    def fsync(descriptor: int) -> None:
        synced.append(Path(f"/proc/self/fd/{descriptor}").readlink().as_posix())

    monkeypatch.setattr(durable.os, "fsync", fsync)
    durable.write_durably(tmp_path / "a/b/c", b"data")
    temporary = synced.pop(0)
    assert temporary.startswith(f"{tmp_path}/a/b/.c.")
    assert {Path(name) for name in synced} == {tmp_path / "a/b", tmp_path / "a", tmp_path}
    assert (tmp_path / "a/b/c").read_bytes() == b"data"


def test_a_failure_is_raised_once_at_close_when_nobody_was_told(
    tmp_path: Path, die_at_write: Callable[[int | None], list[str]]
) -> None:
    async def main() -> None:
        records = LineRecords(SPEC.lines)
        writer = CubeWriter(tmp_path / "a.zarr", SPEC, lines_per_shard=4)
        await writer.open(records)
        die_at_write(0)
        await feed(writer, SPEC, records, range(5), {})
        with pytest.raises(CubeError, match="the disk is gone"):
            await writer.close()
        assert records.stored == 0

    clock.run(main(), virtual=True)
    assert check_cube(tmp_path / "a.zarr", SPEC) == 0


@pytest.fixture
def shard_fails(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The second shard meets a bug, not a disk error."""
    from scanhsi.cube.shards import CubeFiles, ShardPixels

    write = CubeFiles.write_pixels

    def fail(self: CubeFiles, pixels: ShardPixels) -> object:
        if pixels.first == 4:
            raise ZeroDivisionError("a bug")
        return write(self, pixels)

    monkeypatch.setattr(CubeFiles, "write_pixels", fail)
    return


@pytest.mark.usefixtures("shard_fails")
def test_nothing_is_stored_behind_a_hole(tmp_path: Path) -> None:
    async def main() -> None:
        records = LineRecords(SPEC.lines)
        writer = CubeWriter(tmp_path / "a.zarr", SPEC, lines_per_shard=4)
        await writer.open(records)
        with pytest.raises(CubeError, match="lines 4 to 7 .* ZeroDivisionError") as raised:
            await feed_and_flush(writer, records)
        assert isinstance(raised.value.__cause__, ZeroDivisionError)
        with pytest.raises(CubeError):
            await writer.append(10)
        await writer.close()  # told already
        assert records.stored == 3

    clock.run(main(), virtual=True)
    assert check_cube(tmp_path / "a.zarr", SPEC) == 3
    assert not cube_summary(tmp_path / "a.zarr").complete


KILLER = Path(__file__).with_name("killed_writer.py")


def test_killed_at_random_moments(tmp_path: Path) -> None:
    rng = random.Random(1)
    moments = [f"-1:{rng.uniform(0, 0.1)}" for _ in range(4)]
    moments += [f"{rng.randrange(14)}:{rng.uniform(0, 0.03)}" for _ in range(8)]
    subprocess.run([sys.executable, KILLER, tmp_path, *moments], check=True, timeout=100)
    from killed_writer import SPEC as KILLED_SPEC

    stored: list[int] = []
    for number in range(len(moments)):
        path = tmp_path / f"{number}.zarr"
        if path.exists():
            stored.append(check_cube(path, KILLED_SPEC))
    assert any(0 < count < KILLED_SPEC.lines for count in stored), stored


DISK_FULL = """
import json, sys
from pathlib import Path
sys.path[:0] = sys.argv[2:]
from scanhsi import clock
from scanhsi.cube.layout import CubeSpec
from scanhsi.cube.reader import cube_summary
from scanhsi.devices.errors import CubeError
from support.cubes import write_cube
from test_crash import check_cube
spec = CubeSpec(200, 40, 300, "uint16", 16)
path = Path(sys.argv[1]) / "cube.zarr"
try:
    clock.run(write_cube(path, spec, lines_per_shard=16))
except CubeError as error:
    summary = cube_summary(path)
    print(json.dumps({"error": str(error), "stored": check_cube(path, spec), "lines": summary.shape[1]}))
"""


def test_disk_full(tmp_path: Path) -> None:
    """On a real file system that fills up: a clear error, and every line stored before is there."""
    tests = Path(__file__).parents[1]
    shell = 'mount -t tmpfs -o size=2m none "$1" && exec "$2" -c "$3" "$1" "$4" "$5"'
    command = ["unshare", "--user", "--map-root-user", "--mount", "sh", "-c", shell, "sh"]
    arguments = [str(tmp_path), sys.executable, DISK_FULL, str(tests), str(tests / "cube")]
    if subprocess.run([*command[:4], "true"], capture_output=True).returncode:
        (pytest.fail if "CI" in os.environ else pytest.skip)("user namespaces are not allowed here")
    done = subprocess.run([*command, *arguments], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert "is full" in result["error"]
    assert "MB were needed" in result["error"]
    assert result["stored"] == result["lines"]  # there was room left to finish it
    assert result["stored"] in range(16, 100, 16)
