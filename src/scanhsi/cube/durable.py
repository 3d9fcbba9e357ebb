"""Files that are on disk, whole, once they have been written.

zarr's own local store writes a temporary file and renames it, so no reader ever sees half a file; but it never syncs, so a power
cut may leave a name without its contents. What vouches for something else (`status`) must not do that: here every file and
every directory entry is synced before the write returns.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import uuid
from collections.abc import Iterator
from pathlib import Path

from zarr.abc.buffer import Buffer
from zarr.storage import LocalStore


def write_durably(path: Path, data: bytes | bytearray | memoryview) -> None:
    """Write a file so that, whatever happens, ``path`` holds the old contents or all of the new, and the new once this returns.

    Raises:
        OSError: The disk is full, or gone; nothing is left behind.
    """
    changed = _make_directories(path.parent)
    temporary = path.with_name(f".{path.name}.{uuid.uuid4().hex}.partial")
    try:
        with temporary.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except BaseException:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
        raise
    for directory in changed:
        sync_directory(directory)


def sync_directory(path: Path) -> None:
    """Make the names in a directory durable."""
    descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
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


class DurableStore(LocalStore):
    """zarr's local store, with every write durable."""

    async def set(self, key: str, value: Buffer) -> None:
        """Write one key; on disk when it returns."""
        await asyncio.to_thread(self.set_sync, key, value)

    def set_sync(self, key: str, value: Buffer) -> None:
        """Write one key from a thread; on disk when it returns."""
        self._check_writable()
        write_durably(self.root / key, value.as_numpy_array().data)
