"""Carrying out what waits in a spool: in the background of a scan, or afterwards (``scanhsi drain``)."""

from __future__ import annotations

import errno
import socket
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from scanhsi.cube.destination import DestinationError
from scanhsi.cube.lease import Lease
from scanhsi.cube.location import locate
from scanhsi.cube.object_destination import ObjectDestination
from scanhsi.cube.spool import Change, Head, Spool, locked, read_head
from scanhsi.devices.errors import CubeError
from scanhsi.log import get_logger

_log = get_logger(__name__)

_POLL_S = 0.2
_PAUSE_S = 5.0


@dataclass(frozen=True, slots=True)
class Draining:
    """How far a spool is drained.

    Attributes:
        url: Of the cube.
        waiting_bytes: What the server does not have yet.
        elsewhere: Another process, or the scan under way, is at it.
    """

    url: str
    waiting_bytes: int
    elsewhere: bool = False


Progress = Callable[[Draining], None]
"""Called now and then, from the calling thread."""


def remote_of(head: Head, folder: Path, storage_options: Mapping[str, str] | None = None) -> ObjectDestination:
    """Where the files of a spool go."""
    location = locate(head.url, {**head.options, **(storage_options or {})})
    spool = f"{socket.gethostname()}:{folder.absolute()}"
    return ObjectDestination(location, lease=partial(Lease, owner=head.owner, spool=spool))


def carry_out(remote: ObjectDestination, group: Sequence[Change]) -> None:
    """Make the changes of a group, in any order.

    Raises:
        OSError: Some may have been made; all of them can be made again.
    """
    files = {change.key: change.path.read_bytes() for change in group if change.operation == "put"}
    remote.put_all(files, durable=True)
    for change in group:
        if deleted := change.deleted():
            remote.delete(deleted)


class Drainer:
    """Drains the spool of a cube that is being written, in a thread that ends after the writer, or with the main thread.

    Args:
        spool: What waits.
        remote: Where it goes; locked.
        done: Called in the thread when all has gone and the writer had finished, or when the rest must stay.
    """

    def __init__(self, spool: Spool, remote: ObjectDestination, done: Callable[[], None]) -> None:
        self._spool = spool
        self._remote = remote
        self._done = done
        self._finished = threading.Event()
        self._thread = threading.Thread(target=self._run, name="scanhsi drain")
        self._thread.start()

    def finish(self) -> None:
        """Nothing more will come."""
        self._finished.set()

    def join(self, timeout_s: float) -> bool:
        """Wait until the thread has ended; whether it has."""
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _run(self) -> None:
        try:
            if self._drain():
                self._remote.unlock()
                self._spool.remove()
            else:
                self._remote.lease.abandon()
        finally:
            self._done()

    def _drain(self) -> bool:
        """Whether everything has gone."""
        main = threading.main_thread()
        while main.is_alive():
            group = self._spool.next_group(_POLL_S)
            if not group and self._finished.is_set():
                return True
            try:
                if group:
                    carry_out(self._remote, group)
                    self._spool.done(group)
            except OSError as error:
                self._tell(error)
                if not self._remote.lease.held:
                    self._spool.failed(error, for_good=True)
                    return False
                self._spool.failed(error)
                _wait(_PAUSE_S, lambda: not main.is_alive())
            except RuntimeError:  # no new threads: the interpreter is being shut down
                return False
        return False

    def _tell(self, error: OSError) -> None:
        if self._spool.stuck is None:  # once an outage
            waiting_mb = round(self._spool.waiting_bytes / 1e6, 1)
            _log.warning(
                "spool.stuck", cube=self._remote.name, reason=error.strerror or str(error), waiting_mb=waiting_mb
            )


def _wait(seconds: float, until: Callable[[], bool]) -> None:
    end = time.monotonic() + seconds  # in a thread, where there is no loop whose time could be asked
    while time.monotonic() < end and not until():
        time.sleep(min(_POLL_S, seconds))


def drain(
    folder: str | Path, *, storage_options: Mapping[str, str] | None = None, progress: Progress | None = None
) -> list[str]:
    """Send everything that waits in a spool folder, of every cube; wait for those that somebody else drains now.

    Args:
        folder: As given to the scan.
        storage_options: Of the store, where not from the environment; see `scanhsi.open_cube`.
        progress: See `Progress`.

    Returns:
        URLs of the cubes that are whole in their store now.

    Raises:
        CubeError: Something cannot be sent. It stays, and what was sent before is safe: drain again later.
    """
    root = Path(folder)
    if not root.is_dir():
        raise CubeError(f"there is no spool folder {root}.")
    heads = [(path, head) for path in sorted(root.iterdir()) if (head := read_head(path)) is not None]
    for path, head in heads:
        while not _drain_one(path, head, storage_options, progress or (lambda _: None)):
            time.sleep(_POLL_S)
    return [head.url for _, head in heads]


def _drain_one(path: Path, head: Head, options: Mapping[str, str] | None, progress: Progress) -> bool:
    """Drain one spool; False while somebody else is at it."""
    try:
        with locked(path):
            if read_head(path) is not None:
                _drain_locked(path, head, options, progress)
            return True
    except BlockingIOError:
        progress(Draining(head.url, _size(path), elsewhere=True))
        return False
    except FileNotFoundError:  # somebody else was at it, and is done
        return True
    except DestinationError as error:
        raise CubeError(f"cannot send {path} to {head.url}: {error.strerror}.", hint=error.hint) from error
    except OSError as error:
        raise CubeError(f"cannot read the spool {path}: {error.strerror or error}.") from error


def _drain_locked(path: Path, head: Head, options: Mapping[str, str] | None, progress: Progress) -> None:
    spool, remote = Spool(path, 0), remote_of(head, path, options)
    try:
        lock_for_spool(remote, spool)
    except DestinationError:
        if spool.waiting_bytes:
            raise
        spool.remove()  # it was drained, or the cube never came to be: its lease is somebody else's affair
        return
    try:
        while group := spool.next_group(0):
            progress(Draining(head.url, spool.waiting_bytes))
            carry_out(remote, group)
            spool.done(group)
    except BaseException:
        remote.lease.abandon()
        raise
    remote.unlock()
    spool.remove()
    progress(Draining(head.url, 0))


def lock_for_spool(remote: ObjectDestination, spool: Spool) -> None:
    """Take the lease that the spool's writer had.

    Raises:
        DestinationError: Somebody else has it, or had it since, or the cube is gone.
    """
    try:
        remote.lock(ours=True)
    except FileNotFoundError:
        raise DestinationError(
            errno.ENOENT, "that cube is gone", hint=f"remove {spool.path}, if nobody wants it"
        ) from None
    except BlockingIOError as error:
        raise DestinationError(errno.EBUSY, error.strerror or "busy", hint="wait for it") from None


def _size(path: Path) -> int:
    """Bytes of the files in a folder that somebody else is emptying."""
    total = 0
    for file in path.glob("*"):
        try:
            total += file.stat().st_size
        except FileNotFoundError:
            continue
    return total
