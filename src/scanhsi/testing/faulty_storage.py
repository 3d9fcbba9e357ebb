"""Storage that fails as a plan says, around any `Destination`; and one in memory."""

from __future__ import annotations

import errno
import os
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Final

from scanhsi.cube.destination import Destination
from scanhsi.testing.faults import Faults, Kind

_ERRORS: Final = {
    Kind.DISK_FULL: errno.ENOSPC,
    Kind.IO_ERROR: errno.EIO,
    Kind.PERMISSION_LOST: errno.EACCES,
    Kind.NO_HANDLES: errno.EMFILE,
}
_ENDS: Final = (Kind.KILLED, Kind.POWER_CUT)


class FaultyDestination:
    """A `Destination` whose writes fail as a plan says.

    A *write* is a call of ``create``, ``put``, ``put_all`` or ``settle``, or of ``delete`` for any key. When the process is
    "killed" it goes on, but nothing that it writes from then on is there: what the destination inside holds is what a killed
    process leaves, or after a power cut only what had been synced.

    Args:
        inner: Where things really go.
        faults: The plan under way.
        sleep: How a slow write waits, in the thread that writes; in virtual time see `scanhsi.testing.faulty_loop`.
        on_end: Called when the process is killed, in the thread that writes.
    """

    def __init__(
        self,
        inner: Destination,
        faults: Faults,
        *,
        sleep: Callable[[float], None] = time.sleep,
        on_end: Callable[[], None] = lambda: None,
    ) -> None:
        self.inner = inner
        self.over = False
        self._faults = faults
        self._sleep = sleep
        self._on_end = on_end
        self._lock = threading.RLock()
        self._synced: dict[str, bytes | None] = {}  # what a power cut leaves of keys that are not synced

    @property
    def name(self) -> str:
        """As of the destination inside."""
        return self.inner.name

    def create(self, files: Mapping[str, bytes]) -> None:
        """Create the cube."""
        if self._happens("create"):
            self.inner.create(files)

    def lock(self) -> None:
        """Lock it."""
        self.inner.lock()

    def unlock(self) -> None:
        """Unlock it."""
        self.inner.unlock()

    def put(self, key: str, parts: Sequence[memoryview], *, durable: bool) -> None:
        """Write one key."""
        if self._happens(key):
            self._remember(key, durable=durable)
            self.inner.put(key, parts, durable=durable)

    def put_all(self, files: Mapping[str, bytes], *, durable: bool) -> None:
        """Write keys; those of the first half are written when it fails."""
        half = dict(list(files.items())[: len(files) // 2])
        try:
            happens = self._happens(next(iter(files), ""))
        except OSError:
            self._put_all(half, durable=durable)
            raise
        if happens:
            self._put_all(files, durable=durable)

    def _put_all(self, files: Mapping[str, bytes], *, durable: bool) -> None:
        for key in files:
            self._remember(key, durable=durable)
        self.inner.put_all(files, durable=durable)

    def settle(self) -> None:
        """Sync."""
        if self._happens("settle"):
            self.inner.settle()
            with self._lock:
                self._synced.clear()

    def get(self, key: str) -> bytes | None:
        """Read a key."""
        return self.inner.get(key)

    def keys(self, prefix: str) -> list[str]:
        """Keys below a prefix."""
        return self.inner.keys(prefix)

    def delete(self, keys: Iterable[str]) -> None:
        """Remove keys."""
        some = list(keys)
        if some and self._happens("delete"):
            self.inner.delete(some)

    def free_bytes(self) -> int | None:
        """Room left."""
        return 0 if Kind.DISK_FULL in self._faults.kinds() else self.inner.free_bytes()

    def _happens(self, path: str) -> bool:
        """One write: False when there is nobody any more who could make it.

        Raises:
            OSError: The fault.
        """
        kinds = (Kind.WRITE_SLOW, *_ENDS, *_ERRORS)
        due = {kind: fault for kind in kinds if (fault := self._faults.due(kind)) is not None}
        if Kind.WRITE_SLOW in due:
            self._sleep(due[Kind.WRITE_SLOW].for_s or 0.0)
        for kind in due:
            if kind in _ENDS and not self.over:
                self._end(kind)
        for kind in due:
            if kind in _ERRORS and not self.over:
                raise OSError(_ERRORS[kind], os.strerror(_ERRORS[kind]), path)
        return not self.over

    def _end(self, kind: Kind) -> None:
        with self._lock:
            self.over = True
            if kind is Kind.POWER_CUT:
                for key, contents in self._synced.items():
                    if contents is None:
                        self.inner.delete([key])
                    else:
                        self.inner.put(key, [memoryview(contents)], durable=True)
        self._on_end()

    def _remember(self, key: str, *, durable: bool) -> None:
        with self._lock:
            if durable:
                self._synced.pop(key, None)
            elif key not in self._synced and self._faults.has(Kind.POWER_CUT):
                self._synced[key] = self.inner.get(key)


class MemoryDestination:
    """A cube in memory; a `scanhsi.cube.destination.Destination`.

    Attributes:
        files: Key -> contents.
    """

    def __init__(self, name: str = "memory") -> None:
        self.files: dict[str, bytes] = {}
        self._name = name
        self._created = self._locked = False

    @property
    def name(self) -> str:
        """What it is called in messages."""
        return self._name

    @property
    def locked(self) -> bool:
        """Whether somebody writes it."""
        return self._locked

    def create(self, files: Mapping[str, bytes]) -> None:
        """Create the cube."""
        if self._created:
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), self._name)
        self.files, self._created, self._locked = dict(files), True, True

    def lock(self) -> None:
        """Lock it."""
        if not self._created:
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), self._name)
        if self._locked:
            raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN), self._name)
        self._locked = True

    def unlock(self) -> None:
        """Unlock it."""
        self._locked = False

    def put(self, key: str, parts: Sequence[memoryview], *, durable: bool) -> None:
        """Keep a key."""
        del durable
        self.files[key] = b"".join(parts)

    def put_all(self, files: Mapping[str, bytes], *, durable: bool) -> None:
        """Keep keys."""
        del durable
        self.files.update(files)

    def settle(self) -> None:
        """Nothing to do."""

    def get(self, key: str) -> bytes | None:
        """Contents of a key."""
        return self.files.get(key)

    def keys(self, prefix: str) -> list[str]:
        """Keys below a prefix."""
        return sorted(key for key in self.files if key.startswith(f"{prefix}/"))

    def delete(self, keys: Iterable[str]) -> None:
        """Forget keys."""
        for key in list(keys):
            self.files.pop(key, None)

    def free_bytes(self) -> int | None:
        """Nobody knows."""
        return None
