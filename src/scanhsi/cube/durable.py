"""Files that are whole and on disk once they have been written, and a cube's folder made of them.

A file is written under another name, synced, and renamed; then the folders whose entries changed are synced. So a name always
stands for whole contents, whatever happens. Shards are written past the page cache (O_DIRECT) where the file system allows it.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import shutil
import uuid
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final

ALIGNMENT: Final = 4096
"""Addresses, lengths and offsets of direct writes are multiples of this."""

PARTIAL: Final = ".partial"
"""Names of files that are being written end in this, and begin with a dot: ``.0.<random>.partial``."""

_NEW: Final = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC

_MAX_PARTS: Final = 64
_MAX_FILES: Final = 64


def write_durably(path: Path, data: bytes | bytearray | memoryview) -> None:
    """Write a file so that, whatever happens, ``path`` holds the old contents or all of the new, and the new once this returns.

    Raises:
        OSError: The disk is full, or gone; nothing is left behind.
    """
    for directory in write_whole(path, [memoryview(data)]):
        sync_directory(directory)


def write_whole(path: Path, parts: Sequence[memoryview], *, durable: bool = True, direct: bool = False) -> list[Path]:
    """Write a file under another name and rename it; returns the folders that must be synced before a power cut is survived.

    Raises:
        OSError: The disk is full, or gone, or with ``direct`` does not know direct writes (EINVAL); nothing is left behind.
    """
    changed = _make_directories(path.parent)
    temporary = _temporary(path)
    try:
        _write(temporary, parts, durable=durable, direct=direct)
        give_name(temporary, path)
    except BaseException:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
        raise
    return changed


def write_all_durably(files: Mapping[Path, bytes]) -> None:
    """Write small files, each as `write_durably` does; those written so far may have got their names when it fails.

    First the contents of all, then the names of all: one by one each sync would wait for a commit of its own of the file system's
    journal; like this the first one commits for the others, too.

    Raises:
        OSError: The disk is full, or gone.
    """
    temporary = {path: _temporary(path) for path in files}
    changed: dict[Path, None] = {}
    try:
        with contextlib.ExitStack() as opened:
            descriptors: list[int] = []
            for path, data in files.items():
                changed |= dict.fromkeys(_make_directories(path.parent))
                descriptors.append(os.open(temporary[path], _NEW, 0o666))
                opened.callback(os.close, descriptors[-1])
                _write_parts(descriptors[-1], [memoryview(data)], direct=False)
                os.posix_fadvise(descriptors[-1], 0, 0, os.POSIX_FADV_DONTNEED)  # begin to write, do not wait
            for descriptor in descriptors:
                os.fsync(descriptor)
        for path in files:
            give_name(temporary[path], path)
    except BaseException:
        for path in temporary.values():
            with contextlib.suppress(OSError):
                path.unlink(missing_ok=True)
        raise
    for directory in changed:
        sync_directory(directory)


def give_name(temporary: Path, path: Path) -> None:
    """Let a file appear under its name, instead of what was there: the moment at which it is written."""
    temporary.replace(path)


def _temporary(path: Path) -> Path:
    return path.with_name(f".{path.name}.{uuid.uuid4().hex}{PARTIAL}")


def _write(path: Path, parts: Sequence[memoryview], *, durable: bool, direct: bool) -> None:
    descriptor = os.open(path, _NEW | (os.O_DIRECT if direct else 0), 0o666)
    try:
        _write_parts(descriptor, parts, direct=direct)
        if durable:
            os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _write_parts(descriptor: int, parts: Sequence[memoryview], *, direct: bool) -> None:
    rest = [part for part in parts if part.nbytes]
    offset = 0
    while rest:
        written = os.pwritev(descriptor, rest[:_MAX_PARTS], offset)
        if direct:  # a disk that fills may take a piece of a block; the next write says why
            written -= written % ALIGNMENT
        if not written:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        offset += written
        while rest and written >= rest[0].nbytes:
            written -= rest.pop(0).nbytes
        if written:
            rest[0] = rest[0][written:]


def sync_directory(path: Path) -> None:
    """Make the names in a directory durable."""
    descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _sync_file(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _make_directories(path: Path) -> list[Path]:
    """Create a directory with its parents; the directories whose entries change by this and by a new file in it."""
    missing = [path, *(parent for parent in path.parents)]
    new = list(_until_existing(missing))
    path.mkdir(parents=True, exist_ok=True)
    return [path, *(directory.parent for directory in new)]


def _until_existing(paths: list[Path]) -> Iterator[Path]:
    for path in paths:
        if path.is_dir():
            return
        yield path


class LocalDestination:
    """A cube in a folder; a `scanhsi.cube.destination.Destination`.

    Args:
        path: The cube's folder, conventionally ``*.zarr``. Its parent must be there.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._direct = True  # until the file system refuses
        self._unsynced: dict[Path, None] = {}
        self._unsynced_directories: dict[Path, None] = {}
        self._locked: int | None = None

    @property
    def name(self) -> str:
        """Path of the cube."""
        return str(self.path)

    def create(self, files: Mapping[str, bytes]) -> None:
        """Build the cube beside its place and rename it."""
        if self.path.exists() or self.path.is_symlink():
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(self.path))
        if not self.path.parent.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(self.path.parent))
        building = self.path.with_name(f".{self.path.name}.{uuid.uuid4().hex}{PARTIAL}")
        try:
            for key, value in files.items():
                write_durably(building / key, value)
            self._locked = lock_folder(building)  # of the folder, not of its name: it is locked when it appears
            building.rename(self.path)
            sync_directory(self.path.parent)
        except OSError as error:
            self.unlock()
            if error.errno in (errno.EEXIST, errno.ENOTEMPTY, errno.ENOTDIR):  # somebody was faster
                raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(self.path)) from error
            raise
        finally:
            shutil.rmtree(building, ignore_errors=True)

    def lock(self) -> None:
        """Lock the folder; remove temporary files, which nobody writes any more. `settle` syncs the others, too.

        The last writer may have left them to the kernel, and died.
        """
        if self._locked is None:
            self._locked = lock_folder(self.path)
            for leftover in self.path.rglob(f".*{PARTIAL}"):
                leftover.unlink(missing_ok=True)
            for path in (self.path, *self.path.rglob("*")):
                (self._unsynced_directories if path.is_dir() else self._unsynced)[path] = None

    def unlock(self) -> None:
        """Let other writers in."""
        if self._locked is not None:
            os.close(self._locked)
            self._locked = None

    def put(self, key: str, parts: Sequence[memoryview], *, durable: bool) -> None:
        """Write one file; aligned contents past the page cache, where that is possible and pays."""
        path = self.path / key
        changed = self._write(path, parts, durable=durable)
        if durable:
            for directory in changed:
                sync_directory(directory)
        else:
            self._unsynced[path] = None
            self._unsynced_directories |= dict.fromkeys(changed)

    def _write(self, path: Path, parts: Sequence[memoryview], *, durable: bool) -> list[Path]:
        if self._direct and parts and all(part.nbytes % ALIGNMENT == 0 for part in parts):
            try:
                return write_whole(path, parts, durable=durable, direct=True)
            except OSError as error:
                if error.errno not in (errno.EINVAL, errno.EOPNOTSUPP):
                    raise
                self._direct = False
        return write_whole(path, parts, durable=durable)

    def put_all(self, files: Mapping[str, bytes], *, durable: bool) -> None:
        """Write files; durably as many at once as may be open."""
        if not durable:
            for key, value in files.items():
                self.put(key, [memoryview(value)], durable=False)
            return
        paths = [(self.path / key, value) for key, value in files.items()]
        for first in range(0, len(paths), _MAX_FILES):
            write_all_durably(dict(paths[first : first + _MAX_FILES]))

    def settle(self) -> None:
        """Sync every file that was not, then the folders."""
        files, directories = list(self._unsynced), list(self._unsynced_directories)
        for path in files:
            _sync_file(path)
        for directory in directories:
            sync_directory(directory)
        self._unsynced.clear()
        self._unsynced_directories.clear()

    def get(self, key: str) -> bytes | None:
        """Read a file."""
        try:
            return (self.path / key).read_bytes()
        except FileNotFoundError:
            return None

    def keys(self, prefix: str) -> list[str]:
        """Files below a folder, in order."""
        files = (file for file in (self.path / prefix).rglob("*") if not file.name.endswith(PARTIAL) and file.is_file())
        return sorted(file.relative_to(self.path).as_posix() for file in files)

    def delete(self, keys: Iterable[str]) -> None:
        """Remove files, durably; their folders stay."""
        changed: dict[Path, None] = {}
        for key in keys:
            path = self.path / key
            self._unsynced.pop(path, None)
            with contextlib.suppress(FileNotFoundError):
                path.unlink()
                changed[path.parent] = None
        for directory in changed:
            sync_directory(directory)

    def free_bytes(self) -> int | None:
        """Of the file system, where it still answers."""
        try:
            return shutil.disk_usage(self.path if self.path.exists() else self.path.parent).free
        except OSError:
            return None


def lock_folder(path: Path) -> int:
    """Lock a cube's folder for as long as the returned descriptor is open, or the process lives.

    Raises:
        BlockingIOError: Somebody else has locked it.
        OSError: It cannot be opened.
    """
    descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in (errno.EAGAIN, errno.EACCES):
            os.close(descriptor)
            raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN), str(path)) from error
        # a network file system without locks: nobody is kept out, as before
    return descriptor
