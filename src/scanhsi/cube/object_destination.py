"""A cube in an object store (S3 and its like), written with the guarantees of a folder.

* **Whole.** An object is written by one request and appears whole, or not at all. No multipart uploads: a killed one leaves parts
  that are invisible, cost money, and can be found only through an interface that obstore does not have. A shard is far below
  the 5 GB that one request may carry.
* **In order.** The writer asks for pixels, records, status, one after the other, and `put` returns when the server has answered.
  So a line is stored once the server has all of it, and the status in the bucket never vouches for what is not there.
* **Nothing is overwritten.** First comes the lease, which keeps other creators out, then the list of what is there (nothing may
  be), then the arrays' metadata, and the root ``zarr.json`` last, all on the condition that they are not there yet
  (If-None-Match). The root comes last because it makes the cube: before it readers find nothing, and what a killed creator
  left can be told, by the lease that names it, from something of somebody else's.
* **One writer.** A lease keeps others out, see `scanhsi.cube.lease`. Should it fail (a computer that was suspended in the middle of
  a request), every object is still replaced only in the version that this writer saw last (If-Match), so that the one who is
  wrong stops with an error.
"""

from __future__ import annotations

import contextlib
import errno
import os
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Final

from scanhsi.cube.destination import DestinationError
from scanhsi.cube.lease import KEY, Lease
from scanhsi.cube.location import Location
from scanhsi.cube.metadata import ROOT
from scanhsi.cube.objects import Conflict, Objects, Version

_AT_ONCE: Final = 8
"""Requests for small objects under way together: what they wait for is the way to the server and back."""


class ObjectDestination:
    """A cube at a URL; a `scanhsi.cube.destination.Destination`.

    Args:
        location: The URL, with options, see `scanhsi.cube.location.locate`.
        retry_s: How long a request is tried again when the connection or the server fails; then it is an error.
        lease: How the cube is locked; by default as described in `scanhsi.cube.lease`.

    Raises:
        CubeError: obstore is missing, or cannot make sense of the URL.
    """

    def __init__(self, location: Location, *, retry_s: float = 60.0, lease: Callable[[Objects], Lease] = Lease) -> None:
        self.location = location
        self._objects = Objects(location, retry_s=retry_s)
        self.lease = lease(self._objects)
        self._versions: dict[str, Version] = {}
        self._all_known = False  # whether what is not in `versions` is not there

    @property
    def name(self) -> str:
        """URL of the cube."""
        return str(self.location)

    def create(self, files: Mapping[str, bytes]) -> None:
        """Take the lease, look that nothing is there, write the arrays' metadata, then the root."""
        if self._objects.version(ROOT) is not None:
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), self.name)
        try:
            left = self.lease.acquire(creating=list(files))
        except BlockingIOError as error:
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), self.name) from error
        try:
            self.lease.probe()
            self._clear(left)
            self._create(files)
        except BaseException:
            self.unlock()
            raise

    def _clear(self, left: Sequence[str]) -> None:
        """Remove what a killed creator left; anything else must not be there."""
        there = [key for key in self._objects.keys("") if key != KEY]
        if ROOT in there or not set(there) <= set(left):
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), self.name)
        self._objects.delete(there)

    def _create(self, files: Mapping[str, bytes]) -> None:
        self._versions, self._all_known = {}, True
        try:
            self.put_all({key: value for key, value in files.items() if key != ROOT}, durable=True)
            self.put(ROOT, [memoryview(files[ROOT])], durable=True)
        except BaseException as error:
            with contextlib.suppress(OSError):
                self._objects.delete(self._versions)
            if isinstance(error, DestinationError) and isinstance(error.__cause__, Conflict):
                raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), self.name) from error
            raise
        self.lease.created()

    def lock(self, *, ours: bool = False) -> None:
        """Take the lease of a cube that is there; with ``ours`` only if this lease's owner was the last one to have it."""
        if self.lease.held:
            return
        if self._objects.version(ROOT) is None:
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), self.name)
        self._versions, self._all_known = {}, False
        self.lease.acquire(ours=ours)

    def unlock(self) -> None:
        """Give the lease back."""
        self.lease.release()

    def put(self, key: str, parts: Sequence[memoryview], *, durable: bool) -> None:
        """Write one object; it is there for good once the server has answered, ``durable`` or not."""
        self.lease.check()
        replaces = self._versions.get(key)
        if replaces is None and not self._all_known:
            replaces = self._objects.version(key)
        try:
            self._versions[key] = self._objects.put(key, parts, replaces)
        except Conflict as error:
            raise DestinationError(
                errno.EBUSY,
                f"{key} was written by another program meanwhile, and was not overwritten",
                hint="one writer at a time; scanhsi info tells what is there",
            ) from error

    def put_all(self, files: Mapping[str, bytes], *, durable: bool) -> None:
        """Write several objects at once; returns, or raises, when no request is under way."""
        _at_once(
            [
                lambda key=key, value=value: self.put(key, [memoryview(value)], durable=durable)
                for key, value in files.items()
            ]
        )

    def settle(self) -> None:
        """Nothing: what the server has taken is safe."""

    def get(self, key: str) -> bytes | None:
        """Read an object."""
        found = self._objects.get(key)
        return None if found is None else found[0]

    def keys(self, prefix: str) -> list[str]:
        """Keys below a prefix."""
        return self._objects.keys(prefix)

    def delete(self, keys: Iterable[str]) -> None:
        """Remove objects."""
        self.lease.check()
        names = list(keys)
        self._objects.delete(names)
        for key in names:
            self._versions.pop(key, None)

    def free_bytes(self) -> int | None:
        """Nobody knows."""
        return None


def _at_once(tasks: Sequence[Callable[[], None]]) -> None:
    """Run all tasks in a few threads; raises the first error when all have ended. None begins after an error."""
    rest = iter(tasks)
    errors: list[BaseException] = []
    taking = threading.Lock()

    def work() -> None:
        while not errors:
            with taking:
                task = next(rest, None)
            if task is None:
                return
            try:
                task()
            except BaseException as error:
                errors.append(error)

    threads = [threading.Thread(target=work, name="scanhsi put") for _ in range(min(_AT_ONCE, len(tasks)))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    if errors:
        raise errors[0]
