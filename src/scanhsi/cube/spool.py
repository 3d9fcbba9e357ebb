"""Files on their way to an object store, kept in a local folder until the server has them.

A spool is a folder for one cube. Every change of the cube (an object written, objects removed) is a file in it, numbered in the
order in which the changes began, whole and synced before the writer goes on. A thread carries them out in that order and removes
them. So the bucket is always what the cube was at some moment before: a status never vouches for what is not there. Changes that no
status lies between go together.

A file is removed durably before the next group begins: after a power cut nothing can be carried out again that something later has
replaced.
"""

from __future__ import annotations

import errno
import json
import os
import shutil
import threading
from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote, unquote

from scanhsi.cube.durable import PARTIAL, lock_folder, sync_directory, write_durably, write_whole
from scanhsi.cube.metadata import ROOT

HEAD: Final = "spool.json"

_PUT: Final = "put"
_DELETE: Final = "delete"
_GROUP_BYTES: Final = 64_000_000
_GROUP: Final = 32


@dataclass(frozen=True, slots=True, order=True)
class Change:
    """One change of a cube, waiting in a spool.

    Attributes:
        number: Order in which they began.
        operation: ``put`` or ``delete``.
        key: What is written; of a deletion, nothing.
        path: The file: contents, or the JSON list of keys to be removed.
        size: Of the file, bytes.
    """

    number: int
    operation: str
    key: str
    path: Path
    size: int

    def deleted(self) -> list[str]:
        """Keys that are removed."""
        return json.loads(self.path.read_bytes()) if self.operation == _DELETE else []


@dataclass(frozen=True, slots=True)
class Head:
    """Whose spool it is.

    Attributes:
        url: Of the cube.
        options: Of the store, without credentials.
        owner: Of the cube's lease.
    """

    url: str
    options: Mapping[str, str]
    owner: str


class Spool:
    """The folder. Methods may be called from several threads.

    Args:
        path: The folder; it must exist.
        max_bytes: `put` waits where more would be in it.
    """

    def __init__(self, path: Path, max_bytes: int) -> None:
        self.path = path
        self._max_bytes = max_bytes
        self._changed = threading.Condition()
        self._changes = sorted(_found(path))
        self._bytes = sum(change.size for change in self._changes)
        self._next = self._changes[-1].number + 1 if self._changes else 0
        self._taken = 0  # of everything, ever: whether the server takes anything
        self._stuck: OSError | None = None
        self._closed = False  # it will never be drained

    @property
    def waiting_bytes(self) -> int:
        """Bytes that the server does not have yet."""
        with self._changed:
            return self._bytes

    @property
    def stuck(self) -> OSError | None:
        """Why the server took nothing the last time; None where it did."""
        with self._changed:
            return self._stuck

    def put(self, key: str, parts: Sequence[memoryview], patience_s: float) -> None:
        """Add an object to be written. It is on disk when this returns.

        Raises:
            OSError: The spool stayed full, or its disk, for so long without the server taking anything.
        """
        self._add(_PUT, key, parts, patience_s)

    def delete(self, keys: Sequence[str], patience_s: float) -> None:
        """Add objects to be removed."""
        self._add(_DELETE, "", [memoryview(json.dumps(keys).encode())], patience_s)

    def _add(self, operation: str, key: str, parts: Sequence[memoryview], patience_s: float) -> None:
        size = sum(part.nbytes for part in parts)
        with self._changed:
            self._raise_closed()
            number = self._next
            self._next += 1
            self._wait_for_room(size, patience_s)
            self._bytes += size
        path = self.path / f"{number:012d}.{operation}.{quote(key, safe='')}"
        try:
            self._write(path, parts, patience_s)
        except BaseException:
            with self._changed:
                self._bytes -= size
            raise
        with self._changed:
            self._changes.append(Change(number, operation, key, path, size))
            self._changes.sort()
            self._changed.notify_all()

    def _wait_for_room(self, size: int, patience_s: float) -> None:
        """Wait, with the condition held, until so much more is allowed. An empty spool takes anything."""
        while self._bytes and self._bytes + size > self._max_bytes:
            if not self._wait_for_server(patience_s):
                why = f": {self._stuck.strerror}" if self._stuck else ""
                raise OSError(errno.EDQUOT, f"the spool {self.path} is full, and nothing leaves it{why}")

    def _wait_for_server(self, patience_s: float) -> bool:
        """Wait, with the condition held, until something has left the spool; False where nothing did for so long."""
        taken = self._taken
        left = self._changed.wait_for(lambda: self._taken != taken or self._closed, patience_s)
        self._raise_closed()
        return left

    def _raise_closed(self) -> None:
        if self._closed and self._stuck is not None:
            raise self._stuck

    def _write(self, path: Path, parts: Sequence[memoryview], patience_s: float) -> None:
        """Write a file; while its disk is full, wait for something to leave."""
        while True:
            try:
                for directory in write_whole(path, parts):
                    sync_directory(directory)
                return
            except OSError as error:
                if error.errno not in (errno.ENOSPC, errno.EDQUOT):
                    raise
                with self._changed:
                    if not self._changes or not self._wait_for_server(patience_s):
                        raise

    def get(self, key: str) -> tuple[bool, bytes | None]:
        """(whether it waits here, its contents or None where it is to be removed) of a key."""
        while True:
            with self._changed:
                changes = list(self._changes)
            try:
                for change in reversed(changes):
                    if change.operation == _PUT and change.key == key:
                        return True, change.path.read_bytes()
                    if key in change.deleted():
                        return True, None
            except FileNotFoundError:
                continue  # the server has it now
            return False, None

    def overlay(self, there: Sequence[str]) -> list[str]:
        """Keys once all changes are carried out, where ``there`` are in the store now."""
        keys = set(there)
        with self._changed:
            for change in self._changes:
                keys = keys | {change.key} if change.operation == _PUT else keys - set(change.deleted())
        return sorted(keys)

    def next_group(self, timeout_s: float) -> list[Change]:
        """The changes to be carried out now, in any order; empty where none came for so long."""
        with self._changed:
            self._changed.wait_for(lambda: bool(self._changes), timeout_s)
            return _group(self._changes)

    def done(self, group: Sequence[Change]) -> None:
        """The server has carried them out."""
        for change in group:
            change.path.unlink(missing_ok=True)
        sync_directory(self.path)
        numbers = {change.number for change in group}
        with self._changed:
            self._changes = [change for change in self._changes if change.number not in numbers]
            self._bytes -= sum(change.size for change in group)
            self._taken += 1
            self._stuck = None
            self._changed.notify_all()

    def failed(self, error: OSError, *, for_good: bool = False) -> None:
        """The server did not; ``for_good``: and never will."""
        with self._changed:
            self._stuck = error
            self._closed = for_good
            self._changed.notify_all()

    def remove(self) -> None:
        """Remove the folder, which is empty but for its head."""
        with suppress(OSError):
            (self.path / HEAD).unlink()
            self.path.rmdir()


def _group(changes: Sequence[Change]) -> list[Change]:
    """The first changes that no order is needed between: a status, the root and a deletion go alone."""
    group: list[Change] = []
    for change in changes:
        alone = change.operation == _DELETE or change.key == ROOT or change.key.startswith("status/")
        if alone and group:
            break
        if any(change.key == other.key for other in group) or len(group) == _GROUP:
            break
        if group and sum(other.size for other in group) + change.size > _GROUP_BYTES:
            break
        group.append(change)
        if alone:
            break
    return group


def _found(folder: Path) -> Iterator[Change]:
    for path in folder.iterdir():
        number, _, rest = path.name.partition(".")
        operation, _, key = rest.partition(".")
        if number.isdecimal() and operation in (_PUT, _DELETE):
            yield Change(int(number), operation, unquote(key), path, path.stat().st_size)


def read_head(folder: Path) -> Head | None:
    """Whose spool a folder is; None where it is none."""
    try:
        value: dict[str, Any] = json.loads((folder / HEAD).read_bytes())
        return Head(value["url"], value["options"], value["owner"])
    except (FileNotFoundError, NotADirectoryError, ValueError, KeyError, TypeError):
        return None


def write_head(folder: Path, head: Head) -> None:
    """Say whose spool a folder is."""
    value = {"url": head.url, "options": dict(head.options), "owner": head.owner}
    write_durably(folder / HEAD, json.dumps(value, indent=2).encode())


@contextmanager
def locked(folder: Path) -> Generator[None]:
    """Have a folder for oneself; remove what a killed process left half-written.

    Raises:
        BlockingIOError: Another process, or another part of this one, has it.
        FileNotFoundError: It is gone.
    """
    descriptor = lock_folder(folder)
    try:
        for leftover in folder.glob(f".*{PARTIAL}"):
            leftover.unlink(missing_ok=True)
        yield
    finally:
        os.close(descriptor)


def free_bytes(folder: Path) -> int:
    """Of the disk of a spool."""
    return shutil.disk_usage(folder).free
