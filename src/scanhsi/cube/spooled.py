"""A cube in an object store that is written through a local spool: for links that are slower than the camera, or break.

With a spool a line is *stored* once it is on the local disk, in the spool. That survives the death of the process and a power cut,
not the loss of that disk, until the spool is drained. Readers of the bucket see the cube as it was a while ago, always true.

Creating a cube needs the server, to be sure that nothing is overwritten; so does resuming one. In between the link may break for
as long as the spool has room; then the writer waits, for `patience_s`.
"""

from __future__ import annotations

import errno
import hashlib
import os
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Final
from uuid import uuid4

from scanhsi.cube.destination import DestinationError
from scanhsi.cube.drain import Drainer, lock_for_spool, remote_of
from scanhsi.cube.location import Location
from scanhsi.cube.object_destination import ObjectDestination
from scanhsi.cube.spool import Head, Spool, free_bytes, locked, read_head, write_head

MAX_BYTES: Final = 50_000_000_000
PATIENCE_S: Final = 300.0

_HARMLESS: Final = frozenset(
    {"endpoint", "region", "default_region", "allow_http", "virtual_hosted_style_request", "account_name", "bucket"}
)
"""Options that may stand in a file; credentials must come from the environment when a spool is drained later."""


class SpooledDestination:
    """A cube at a URL; a `scanhsi.cube.destination.Destination`.

    Args:
        location: The URL, with options.
        folder: Of spools; made if it is not there. Each cube has its own folder in it.
        max_bytes: Of this cube on the local disk at most (besides, one object is always taken).
        patience_s: How long a full spool is waited for without the server taking anything.
    """

    def __init__(
        self, location: Location, folder: Path, *, max_bytes: int = MAX_BYTES, patience_s: float = PATIENCE_S
    ) -> None:
        self.location = location
        self.folder = folder / _folder_name(location)
        self._max_bytes = max_bytes
        self._patience_s = patience_s
        self._keys: set[str] = set()
        self._new = False  # whether the spool's folder was made here
        self._spool: Spool | None = None
        self._remote: ObjectDestination | None = None
        self._drainer: Drainer | None = None
        self._held = ExitStack()

    @property
    def name(self) -> str:
        """URL of the cube."""
        return str(self.location)

    def create(self, files: Mapping[str, bytes]) -> None:
        """Create the cube in the store, at once."""
        with ExitStack() as held:
            head = self._open(held)
            spool = Spool(self.folder, self._max_bytes)
            if spool.waiting_bytes:  # of a cube of this name
                raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), self.name)
            remote = remote_of(head, self.folder, self.location.options)
            try:
                remote.create(files)
            except BaseException:
                self._forget(spool)
                raise
            self._keys = set(files)
            self._begin(spool, remote, held)

    def lock(self) -> None:
        """Take the lease of a cube that is there, and drain what waits for it."""
        if self._spool is not None:
            return
        with ExitStack() as held:
            head = self._open(held)
            spool = Spool(self.folder, self._max_bytes)
            remote = remote_of(head, self.folder, self.location.options)
            try:
                if spool.waiting_bytes:
                    lock_for_spool(remote, spool)
                else:
                    remote.lock()
                self._keys = set(spool.overlay(remote.keys("")))
            except BaseException:
                if spool.waiting_bytes:
                    remote.lease.abandon()
                elif remote.lease.held:
                    remote.unlock()
                else:
                    self._forget(spool)
                raise
            self._begin(spool, remote, held)

    def _open(self, held: ExitStack) -> Head:
        """Lock the spool's folder, and say whose it is."""
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            held.enter_context(locked(self.folder))
            head = read_head(self.folder)
            self._new = head is None
            if head is None:
                options = {key: value for key, value in self.location.options.items() if key.lower() in _HARMLESS}
                head = Head(self.name, options, uuid4().hex)
                write_head(self.folder, head)
            return head
        except BlockingIOError:
            raise DestinationError(
                errno.EBUSY, f"its spool {self.folder} is in use: being filled, or drained", hint="wait for it"
            ) from None
        except OSError as error:
            raise self._told(error) from error

    def _forget(self, spool: Spool) -> None:
        """Remove a spool that never was used. One that was there before stays: a lease may name its owner."""
        if self._new:
            spool.remove()

    def _begin(self, spool: Spool, remote: ObjectDestination, held: ExitStack) -> None:
        self._spool, self._remote, self._held = spool, remote, held.pop_all()
        self._drainer = Drainer(spool, remote, self._held.close)

    def unlock(self) -> None:
        """Nothing more will be written. Draining goes on in the background; others may write the cube when it is done."""
        if self._drainer is not None:
            self._drainer.finish()

    def put(self, key: str, parts: Sequence[memoryview], *, durable: bool) -> None:
        """Write one object into the spool."""
        try:
            self._opened().put(key, parts, self._patience_s)
        except OSError as error:
            raise self._told(error) from error
        self._keys.add(key)

    def put_all(self, files: Mapping[str, bytes], *, durable: bool) -> None:
        """Write several."""
        for key, value in files.items():
            self.put(key, [memoryview(value)], durable=durable)

    def settle(self) -> None:
        """Nothing: what is in the spool is on disk."""

    def get(self, key: str) -> bytes | None:
        """Read an object, from the spool or the store."""
        waits, contents = self._opened().get(key)
        if waits:
            return contents
        assert self._remote is not None
        return self._remote.get(key)

    def keys(self, prefix: str) -> list[str]:
        """Keys below a prefix; the store is not asked."""
        return sorted(key for key in self._keys if key.startswith(f"{prefix}/"))

    def delete(self, keys: Iterable[str]) -> None:
        """Remove objects."""
        names = [key for key in keys if key in self._keys]
        if names:
            try:
                self._opened().delete(names, self._patience_s)
            except OSError as error:
                raise self._told(error) from error
            self._keys.difference_update(names)

    def free_bytes(self) -> int | None:
        """Of the spool's disk."""
        try:
            return free_bytes(self.folder)
        except OSError:
            return None

    def drained(self, timeout_s: float) -> bool:
        """Wait until the thread that drains has ended, after `unlock`; whether it has."""
        return self._drainer is None or self._drainer.join(timeout_s)

    def _opened(self) -> Spool:
        if self._spool is None:
            raise RuntimeError("the spool is not open")
        return self._spool

    def _told(self, error: OSError) -> DestinationError:
        """An error of the spool, as the user needs to read it."""
        if isinstance(error, DestinationError):
            return error
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            full = f"the disk of the spool {self.folder} is full"
            text = error.strerror if error.errno == errno.EDQUOT and error.strerror else full
            hint = f"scanhsi drain {self.folder.parent} when the link is well, and a larger spool; lines stored so far are safe"
            return DestinationError(error.errno, text, hint=hint)
        text = f"the spool {self.folder} cannot be written ({error.strerror})"
        return DestinationError(error.errno or errno.EIO, text, hint="another folder for the spool")


def _folder_name(location: Location) -> str:
    """A folder for each cube, also where cubes on two servers have the same URL."""
    place = f"{location.text} {location.options.get('endpoint') or os.environ.get('AWS_ENDPOINT_URL', '')}"
    return f"{location.text.rpartition('/')[2]}-{hashlib.sha256(place.encode()).hexdigest()[:12]}"
