"""A file system that fails on command: passes everything through to a folder until it is told otherwise.

``python faulty_fs.py BACKING MOUNT`` serves until its stdin closes. Each line on stdin is a fault as JSON (`support.faults.Fault`),
each is answered by one line: what was done since the last one. `support.faults.FaultyFs` starts it in a mount namespace of its
own, so that the mount is seen by nobody else and goes with the process.
"""

from __future__ import annotations

import errno
import json
import os
import signal
import sys
import threading
import time
from pathlib import Path
from typing import Any

os.environ.setdefault("FUSE_LIBRARY_NAME", "fuse3")

from mfusepy import FUSE, Operations

sys.path.insert(0, str(Path(__file__).parents[1]))

from support.volatile import Volatile

CHANGES = frozenset({"write", "fsync", "rename", "create", "mkdir", "unlink", "rmdir", "truncate", "fallocate", "link"})


class Faults:
    """Counts changes and decides which of them fail."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self.arm({})

    def arm(self, fault: dict[str, Any]) -> dict[str, Any]:
        """Take a new fault, forget the old one; tell what happened meanwhile."""
        with self._lock:
            told = {name: getattr(self, f"_{name}", missing) for name, missing in (("changes", []), ("fired", 0))}
            told["room"] = getattr(self, "room", None)
            self._ops = frozenset(fault.get("ops") or CHANGES)
            self._after = fault.get("after", 0)
            self._error = fault.get("error")
            self._once = fault.get("once", False)
            self._kill = fault.get("kill")
            self.room: int | None = fault.get("room")
            self.delay_s = fault.get("delay_s", 0.0)
            self._count = 0
            self._fired = 0
            self._changes: list[str] = []
            return told

    def fires(self, op: str, path: str) -> bool:
        """Note a change; whether the fault is to happen at this one. Raises the fault itself, if it is an error."""
        with self._lock:
            self._changes.append(f"{op} {path}")
            if op not in self._ops or not (self._error or self._kill):
                return False
            number, self._count = self._count, self._count + 1
            if number < self._after or (number > self._after and self._once):
                return False
            self._fired += 1
            if self._error:
                raise OSError(getattr(errno, self._error), "injected", path)
            return number == self._after

    def kill(self) -> None:
        """End the victim; it does not see the end of what it is doing."""
        if self._kill:
            os.kill(self._kill, signal.SIGKILL)

    def grant(self, size: int) -> int:
        """How much of a write there is still room for."""
        with self._lock:
            if self.room is None:
                return size
            granted = min(size, self.room)
            self.room -= granted
            if not granted and size:
                self._fired += 1
                raise OSError(errno.ENOSPC, "injected")
            return granted


class PassThrough(Operations):
    """Everything goes to the same name below another folder."""

    use_ns = True

    def __init__(self, backing: Path, faults: Faults, volatile: Volatile) -> None:
        self._backing = str(backing)
        self._faults = faults
        self._volatile = volatile

    def init(self, path: str) -> None:
        answer({"ready": True})

    def _change(self, op: str, path: str, act: Any, note: Any = lambda: None) -> Any:
        """Do a change and note it, or die in the middle of it: after it was done, before it is known."""
        fires = self._faults.fires(op, path)
        result = act()
        note()
        if fires:
            self._faults.kill()
        return result

    def write(self, path: str, data: bytes, offset: int, fi: Any) -> int:
        if self._faults.delay_s:
            time.sleep(self._faults.delay_s)
        fires = self._faults.fires("write", path)
        written = os.pwrite(fi.fh, data[: len(data) // 2] if fires else data[: self._faults.grant(len(data))], offset)
        if fires:
            self._faults.kill()
        return written

    def create(self, path: str, mode: int, fi: Any) -> int:
        flags = fi.flags | os.O_CREAT
        fi.fh = self._change(
            "create", path, lambda: self._open(path, flags, mode), lambda: self._volatile.created(path)
        )
        return 0

    def open(self, path: str, fi: Any) -> int:
        if fi.flags & (os.O_WRONLY | os.O_RDWR | os.O_TRUNC):
            fi.fh = self._change("create", path, lambda: self._open(path, fi.flags))
        else:
            fi.fh = self._open(path, fi.flags)
        return 0

    def _open(self, path: str, flags: int, mode: int = 0) -> int:
        if flags & os.O_DIRECT:
            self._faults.fires("direct", path)
        return os.open(self._backing + path, flags & ~os.O_DIRECT, mode)

    def read(self, path: str, size: int, offset: int, fi: Any) -> bytes:
        return os.pread(fi.fh, size, offset)

    def fsync(self, path: str, datasync: int, fi: Any) -> int:
        return self._change("fsync", path, lambda: 0, lambda: self._volatile.synced(path))

    def fsyncdir(self, path: str, datasync: int, fi: Any) -> int:
        return self._change("fsync", path, lambda: 0, lambda: self._volatile.synced(path))

    def truncate(self, path: str, length: int, fi: Any = None) -> int:
        return self._change("truncate", path, lambda: os.truncate(self._backing + path, length))

    def fallocate(self, path: str, mode: int, offset: int, length: int, fi: Any) -> int:
        if self._faults.room is not None and length > self._faults.room:
            raise OSError(errno.ENOSPC, "injected", path)
        return self._change("fallocate", path, lambda: os.posix_fallocate(fi.fh, offset, length))

    def rename(self, old: str, new: str) -> int:
        return self._change(
            "rename",
            new,
            lambda: os.rename(self._backing + old, self._backing + new),
            lambda: self._volatile.renamed(old, new),
        )

    def mkdir(self, path: str, mode: int) -> int:
        return self._change(
            "mkdir", path, lambda: os.mkdir(self._backing + path, mode), lambda: self._volatile.made(path)
        )

    def unlink(self, path: str) -> int:
        return self._change(
            "unlink", path, lambda: os.unlink(self._backing + path), lambda: self._volatile.removed(path)
        )

    def rmdir(self, path: str) -> int:
        return self._change("rmdir", path, lambda: os.rmdir(self._backing + path), lambda: self._volatile.removed(path))

    def flush(self, path: str, fi: Any) -> int:
        return 0

    def release(self, path: str, fi: Any) -> int:
        os.close(fi.fh)
        return 0

    def getattr(self, path: str, fi: Any = None) -> dict[str, Any]:
        found = os.lstat(self._backing + path)
        names = ("st_mode", "st_nlink", "st_size", "st_uid", "st_gid", "st_blocks", "st_ino")
        times = {f"st_{name}": getattr(found, f"st_{name}_ns") for name in ("atime", "mtime", "ctime")}
        return {name: getattr(found, name) for name in names} | times

    def readdir(self, path: str, fi: Any) -> list[str]:
        return [".", "..", *os.listdir(self._backing + path)]

    def chmod(self, path: str, mode: int) -> int:
        os.chmod(self._backing + path, mode)
        return 0

    def utimens(self, path: str, times: Any = None) -> int:
        os.utime(self._backing + path, ns=times)
        return 0

    def statfs(self, path: str) -> dict[str, int]:
        found = os.statvfs(self._backing + path)
        told = {name: getattr(found, name) for name in dir(found) if name.startswith("f_")}
        if self._faults.room is not None:
            told |= dict.fromkeys(("f_bfree", "f_bavail"), self._faults.room // found.f_frsize)
        return told


def answer(value: dict[str, Any]) -> None:
    sys.stdout.write(json.dumps(value) + "\n")
    sys.stdout.flush()


def obey(faults: Faults, volatile: Volatile, backing: Path) -> None:
    for line in sys.stdin:
        order = json.loads(line)
        if "cut" in order:
            volatile.cut(Path(order["cut"]), order["how"], backing)
        elif "forget" in order:
            volatile.forget()
        answer(faults.arm(order))
    os._exit(0)  # whoever started this is gone; so is the namespace with the mount


def main() -> None:
    backing, mount = Path(sys.argv[1]), sys.argv[2]
    faults = Faults()
    volatile = Volatile(backing, backing.with_name("synced"))
    threading.Thread(target=obey, args=(faults, volatile, backing), daemon=True).start()
    options = {"attr_timeout": 0, "entry_timeout": 0, "negative_timeout": 0}
    operations = PassThrough(backing, faults, volatile)
    FUSE(operations, mount, foreground=True, nothreads=True, fsname="faulty", raw_fi=True, **options)


if __name__ == "__main__":
    main()
