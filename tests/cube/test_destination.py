"""A cube's folder as a destination: direct writes and their fallbacks, syncing late, keys, locks."""

from __future__ import annotations

import errno
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from scanhsi.cube import durable
from scanhsi.cube.buffers import aligned_memory
from scanhsi.cube.destination import Destination
from scanhsi.cube.durable import LocalDestination


@pytest.fixture
def cube(tmp_path: Path) -> LocalDestination:
    destination = LocalDestination(tmp_path / "c.zarr")
    destination.create({"zarr.json": b"{}", "status/zarr.json": b"{}"})
    return destination


def shard(pages: int = 3) -> memoryview:
    memory = aligned_memory(pages * 4096)
    np.frombuffer(memory, np.uint8)[:] = np.arange(pages * 4096) % 251
    return memory


def test_it_is_a_destination(cube: LocalDestination) -> None:
    destination: Destination = cube
    part = shard()
    destination.put("cube/c/0/1/0", [part, part[:4096]], durable=True)
    assert destination.get("cube/c/0/1/0") == part.tobytes() + part[:4096].tobytes()
    assert destination.get("cube/c/0/2/0") is None
    destination.put_all({"status/c/0": b"abc", "time/c/0": b"de"}, durable=False)
    assert destination.keys("status") == ["status/c/0", "status/zarr.json"]
    assert destination.keys("nothing") == []
    destination.delete(["status/c/0", "status/c/9"])
    assert destination.keys("status") == ["status/zarr.json"]
    destination.settle()
    assert (destination.free_bytes() or 0) > 0


@pytest.mark.parametrize("refusal", ["open", "write"])
def test_a_file_system_without_direct_writes(
    cube: LocalDestination, monkeypatch: pytest.MonkeyPatch, refusal: str
) -> None:
    opened: list[bool] = []
    real_open, real_write = os.open, os.pwritev

    def open_file(path: Path, flags: int, mode: int = 0o777) -> int:
        if flags & os.O_WRONLY:
            opened.append(bool(flags & os.O_DIRECT))
            if flags & os.O_DIRECT and refusal == "open":
                raise OSError(errno.EINVAL, "no direct writes")
        return real_open(path, flags, mode)

    def write(descriptor: int, parts: Sequence[memoryview], offset: int) -> int:
        if refusal == "write" and opened[-1]:
            raise OSError(errno.EINVAL, "not so aligned")
        return real_write(descriptor, parts, offset)

    monkeypatch.setattr(durable.os, "open", open_file)
    monkeypatch.setattr(durable.os, "pwritev", write)
    for key in ("a", "b"):
        cube.put(key, [shard()], durable=True)
        assert cube.get(key) == shard().tobytes()
    assert opened == [True, False, False]  # tried once
    assert sorted(file.name for file in cube.path.iterdir()) == ["a", "b", "status", "zarr.json"]


def test_short_writes_go_on_where_they_ended(cube: LocalDestination, monkeypatch: pytest.MonkeyPatch) -> None:
    real_write = os.pwritev
    calls: list[int] = []

    def write_little(descriptor: int, parts: Sequence[memoryview], offset: int) -> int:
        calls.append(offset)
        return real_write(descriptor, [parts[0][:5000]] if len(calls) % 2 else parts, offset)

    cube._direct = False
    monkeypatch.setattr(durable.os, "pwritev", write_little)
    parts = [shard(), shard(2), memoryview(b"tail")]
    cube.put("a", parts, durable=False)
    assert cube.get("a") == b"".join(parts)
    assert calls[1] == 5000


def test_a_disk_that_takes_nothing_is_full(cube: LocalDestination, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(durable.os, "pwritev", lambda *_: 100)  # less than a block, with direct writes
    with pytest.raises(OSError, match="No space") as raised:
        cube.put("a", [shard()], durable=True)
    assert raised.value.errno == errno.ENOSPC
    assert cube.get("a") is None


def test_settle_syncs_what_was_not(cube: LocalDestination, monkeypatch: pytest.MonkeyPatch) -> None:
    synced: list[str] = []

    def fsync(descriptor: int) -> None:
        synced.append(Path(f"/proc/self/fd/{descriptor}").readlink().relative_to(cube.path).as_posix())

    monkeypatch.setattr(durable.os, "fsync", fsync)
    cube.put("cube/c/0/0/0", [shard()], durable=False)
    cube.put_all({"time/c/0": b"x"}, durable=False)
    assert not synced
    cube.settle()
    assert synced[:2] == ["cube/c/0/0/0", "time/c/0"]
    assert set(synced[2:]) == {"cube/c/0/0", "cube/c/0", "cube/c", "cube", "time/c", "time", "."}
    synced.clear()
    cube.settle()
    assert not synced


def test_what_a_dead_writer_left_to_the_kernel_is_synced(
    cube: LocalDestination, monkeypatch: pytest.MonkeyPatch
) -> None:
    cube.put("time/c/0", [memoryview(b"x")], durable=False)
    cube.unlock()
    synced: list[Path] = []
    monkeypatch.setattr(durable.os, "fsync", lambda file: synced.append(Path(f"/proc/self/fd/{file}").readlink()))
    other = LocalDestination(cube.path)
    other.lock()
    other.settle()
    assert set(synced) == {cube.path, *cube.path.rglob("*")}


def test_create_locks_and_never_overwrites(cube: LocalDestination) -> None:
    with pytest.raises(FileExistsError):
        LocalDestination(cube.path).create({"zarr.json": b"other"})
    assert cube.get("zarr.json") == b"{}"
    other = LocalDestination(cube.path)
    with pytest.raises(BlockingIOError):
        other.lock()
    cube.unlock()
    other.lock()
    other.lock()  # its own already
    with pytest.raises(NotADirectoryError):
        LocalDestination(cube.path / "no" / "c").create({"zarr.json": b""})
    with pytest.raises(FileNotFoundError):
        LocalDestination(cube.path / "no").lock()
    other.unlock()
