"""The lock of a cube in an object store, which has no locks: an object in the cube that its writer renews.

Whoever creates `KEY` holds the cube, and replaces it (If-Match) every few seconds. Nobody's clock is compared with anybody else's:
who finds a lease watches it, and takes it over when it has not changed for `TTL_S` of the watcher's own time; a lease of a process
of this computer that is gone is taken over at once. A holder that could not renew its lease for so long starts no more writes
until it has; it may find that it lost the cube, and then stops. What such a holder had sent before and what arrives late is kept
from doing harm by the conditions of every write, see `scanhsi.cube.objects`.
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
import socket
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final
from uuid import uuid4

from scanhsi.cube.destination import DestinationError
from scanhsi.cube.objects import Conflict, Objects, Version

KEY: Final = ".writer.json"
"""Of the lease, in the cube; removed when the cube is closed."""

TTL_S: Final = 60.0
"""So long after its last change a lease may be taken over."""

BEAT_S: Final = 5.0
"""Between two renewals."""

_HELD: Final[set[str]] = set()
"""Leases that this process holds: others that name it are of writers that ended without reaching the server."""


class Lease:
    """Of one cube.

    Args:
        objects: Of the cube.
        owner: Identifies who writes, if that outlives the process: a spool. By default this object.
        spool: Where lines wait that are not in the cube yet, for people; None without a spool.
        ttl_s: See `TTL_S`; the same for all writers of a store.
        beat_s: See `BEAT_S`.
    """

    def __init__(
        self,
        objects: Objects,
        *,
        owner: str | None = None,
        spool: str | None = None,
        ttl_s: float = TTL_S,
        beat_s: float = BEAT_S,
    ) -> None:
        self._objects = objects
        self.owner = owner or uuid4().hex
        self._spool = spool
        self._ttl_s = ttl_s
        self._beat_s = beat_s
        self._creating: list[str] | None = None
        self._version: Version | None = None
        self._renewing = threading.Lock()
        self._beats = 0
        self._renewed_s = 0.0
        self._stop = threading.Event()
        self._lost: DestinationError | None = None

    @property
    def held(self) -> bool:
        """Whether it was acquired, and neither lost nor released."""
        return self._version is not None and self._lost is None

    def acquire(self, creating: Sequence[str] | None = None, *, ours: bool = False) -> list[str]:
        """Take the cube, if nobody has it; takes up to `TTL_S` where its writer was killed on another computer.

        Args:
            creating: Keys that are going to be written before there is a cube; None where there is one.
            ours: Only where this owner was the last one to have it.

        Returns:
            Such keys of a writer that was killed while it created the cube: they may be there.

        Raises:
            BlockingIOError: Somebody is writing it.
            DestinationError: Lines of it wait in a spool, or another owner had it, or the store cannot be used.
        """
        self._creating = list(creating) if creating is not None else None
        self._lost = None
        _HELD.add(self.owner)
        try:
            left = self._take(ours)
        except BaseException:
            _HELD.discard(self.owner)
            raise
        self._stop = threading.Event()
        threading.Thread(target=self._beat, args=(self._stop,), name="scanhsi lease").start()
        return left

    def _take(self, ours: bool) -> list[str]:
        while True:
            started_s = _now_s()
            if not ours:
                with contextlib.suppress(Conflict):
                    self._note(self._objects.put(KEY, [self._document()], None), started_s)
                    return []
            found = self._objects.get(KEY)
            if found is None:
                if ours:
                    raise _not_ours()
                continue  # released in this moment
            holder, version = _decoded(found[0]), found[1]
            if ours and holder.get("owner") != self.owner:
                raise _not_ours()
            self._check_spool(holder)
            if _is_held_here(holder):
                raise _busy(holder)
            if not self._is_dead(holder) and not self._wait(version):
                continue
            started_s = _now_s()
            try:
                self._note(self._objects.put(KEY, [self._document()], version), started_s)
            except Conflict:
                raise _busy(holder) from None
            return list(holder.get("creating") or ())

    def _check_spool(self, holder: dict[str, Any]) -> None:
        spool = holder.get("spool")
        if spool and holder.get("owner") != self.owner and not holder.get("creating"):
            raise DestinationError(
                errno.EBUSY,
                f"lines of it wait in the spool {spool}, and are not in the cube yet",
                hint=f"scanhsi drain there; if that spool is lost, remove {KEY} from the cube to go on without those lines",
            )

    def _is_dead(self, holder: dict[str, Any]) -> bool:
        """Whether the holder certainly does not write any more."""
        process = holder.get("process")
        if process == _this_process():
            return True  # what it holds was looked at before
        return isinstance(process, dict) and _has_ended(process)  # pyright: ignore[reportUnknownArgumentType] from JSON

    def _wait(self, version: Version) -> bool:
        """Watch a lease: True once it may be taken over, False where it is gone.

        Raises:
            BlockingIOError: It is renewed: somebody is alive.
        """
        until = _now_s() + self._ttl_s
        while _now_s() < until:
            time.sleep(self._beat_s / 10)
            found = self._objects.get(KEY)
            if found is None:
                return False
            if found[1] != version:
                raise _busy(_decoded(found[0]))
        return True

    def check(self) -> None:
        """Be sure that the cube is ours, before something is written.

        Raises:
            DestinationError: It is not any more, or nobody can tell.
        """
        if self._lost is not None:
            raise self._lost
        if self._version is None:
            raise RuntimeError("the cube is not locked")
        if _now_s() > self._renewed_s + 0.75 * self._ttl_s:
            self._renew()

    def created(self) -> None:
        """Say that the cube is there."""
        self._creating = None
        with contextlib.suppress(DestinationError):
            self._renew(retry_s=0.0)  # or with the next beat: the root tells it, too
        self.check()

    def _renew(self, retry_s: float | None = None) -> None:
        with self._renewing:
            if self._version is None:  # released meanwhile
                return
            started_s = _now_s()
            try:
                version = self._objects.put(KEY, [self._document()], self._version, retry_s)
            except Conflict:
                self._lost = DestinationError(
                    errno.EBUSY,
                    "another writer took the cube over while this one could not be heard of",
                    hint="scanhsi info tells what is there; nothing of the other's was overwritten",
                )
                _HELD.discard(self.owner)
                raise self._lost from None
            self._note(version, started_s)

    def _note(self, version: Version, started_s: float) -> None:
        self._version = version
        self._renewed_s = started_s  # when it was sent: others count from when it arrived

    def _beat(self, stop: threading.Event) -> None:
        main = threading.main_thread()
        next_s = _now_s() + self._beat_s
        while not stop.wait(min(self._beat_s, 0.25)) and main.is_alive() and self._lost is None:
            if _now_s() >= next_s:
                with contextlib.suppress(OSError):  # whoever writes next asks again, and tells
                    self._renew(retry_s=0.0)
                next_s = _now_s() + self._beat_s

    def abandon(self) -> None:
        """Stop renewing: the lease stays, and tells others whose it was."""
        self._stop.set()
        self._version = None
        _HELD.discard(self.owner)

    def release(self) -> None:
        """Let others have the cube at once. Where the server cannot be reached, they have it when the lease has run out."""
        self._stop.set()
        if self._version is not None and self._lost is None:
            with contextlib.suppress(OSError):
                self._renew(retry_s=2.0)  # so that it is certainly ours that is removed
                self._objects.delete([KEY])
        self._version = None
        _HELD.discard(self.owner)

    def probe(self) -> None:
        """Be sure that the server keeps conditions: everything else rests on them.

        Raises:
            DestinationError: It does not.
        """
        with self._renewing:
            other = json.dumps({**self._fields(), "probe": True}).encode()
            never = {name: f'"{"0" * 32}"' if name == "e_tag" else "1" for name in self._version or {}}
            for replaces in (None, never):
                with contextlib.suppress(Conflict):
                    self._objects.put(KEY, [other], replaces)
                    header = "If-None-Match" if replaces is None else "If-Match"
                    raise DestinationError(
                        errno.EOPNOTSUPP,
                        f"the server ignores conditions ({header}), so two writers could overwrite each other",
                        hint="a server that keeps them (Amazon S3, MinIO, SeaweedFS, Ceph, R2 do), or a local cube that is copied",
                    )

    def _document(self) -> bytes:
        self._beats += 1
        return json.dumps({**self._fields(), "beat": self._beats}).encode()

    def _fields(self) -> dict[str, Any]:
        return {
            "comment": "a scanhsi writer is at work here, or was killed",
            "owner": self.owner,
            "host": socket.gethostname(),
            "process": _this_process(),
            "spool": self._spool,
            "creating": self._creating,
        }


def _not_ours() -> DestinationError:
    return DestinationError(
        errno.EBUSY,
        "another writer has gone on with it since",
        hint="scanhsi info tells what is there; nothing of it was overwritten",
    )


def _busy(holder: dict[str, Any]) -> BlockingIOError:
    return BlockingIOError(errno.EAGAIN, f"a process on {holder.get('host', 'another computer')} is writing it")


def _is_held_here(holder: dict[str, Any]) -> bool:
    return holder.get("process") == _this_process() and holder.get("owner") in _HELD


def _decoded(document: bytes) -> dict[str, Any]:
    """A lease; empty where somebody else wrote something there."""
    try:
        value: object = json.loads(document)
    except ValueError:
        return {}
    return {str(key): item for key, item in value.items()} if isinstance(value, dict) else {}  # pyright: ignore[reportUnknownVariableType, reportUnknownArgumentType] from JSON


def _now_s() -> float:
    """Time that goes on while the computer sleeps. Leases are renewed in threads, where there is no loop to be asked."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)


def _this_process() -> dict[str, Any]:
    """What tells this process from every other one, here and elsewhere."""
    return {**_system(), "pid": os.getpid(), "started": _started(os.getpid())}


def _system() -> dict[str, str]:
    """This boot of this computer, and what its process ids belong to (a container has its own)."""
    return {
        "boot": Path("/proc/sys/kernel/random/boot_id").read_text().strip(),
        "namespace": str(Path("/proc/self/ns/pid").readlink()),
    }


def _started(pid: int) -> int | None:
    """When a process started, in ticks since the boot; None where there is none."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return None
    return int(stat.rpartition(")")[2].split()[19])


def _has_ended(process: dict[str, Any]) -> bool:
    """Whether a process was one of this computer, and is not any more."""
    if any(process.get(key) != value for key, value in _system().items()):
        return False
    pid = process.get("pid")
    return isinstance(pid, int) and _started(pid) != process.get("started")
