"""Faults of a file system, on command: `Fault` says which, `FaultyFs` is where they happen."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import pytest


@dataclass(frozen=True, slots=True)
class Fault:
    """What goes wrong with the changes made to a file system from now on; nothing, as it stands.

    Attributes:
        error: Name of an error (``EIO``) that changes end with.
        kill: Process that gets SIGKILL in the middle of a change: half of a write is written, anything else is done, but no
            answer ever comes.
        after: So many changes still go well.
        once: Only the next one fails, the later ones go well again.
        ops: Which changes count and fail (``write``, ``fsync``, ``rename``, ``create``, ``mkdir``, ``unlink``, ...); all if
            empty. ``direct`` is opening a file for direct writes, which is no change of its own.
        room: Bytes that may still be written before the disk is full.
        delay_s: What every write takes.
    """

    error: str | None = None
    kill: int | None = None
    after: int = 0
    once: bool = False
    ops: tuple[str, ...] = ()
    room: int | None = None
    delay_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Happened:
    """What was done to a file system since it was last asked.

    Attributes:
        changes: ``<operation> <path>``, those that failed too.
        fired: How many failed.
        room: Bytes that could still be written.
    """

    changes: list[str]
    fired: int
    room: int


class FaultyFs:
    """A file system (`support.faulty_fs`) over a folder; a context manager.

    It is mounted in a private namespace and reached through that process's root: nothing outside sees it, and nothing is left
    mounted however the tests end.

    Attributes:
        backing: Folder that holds the files: what is really there.
        path: The same through the faulty file system.
    """

    def __init__(self, folder: Path) -> None:
        self.backing = folder / "backing"
        mount = folder / "mount"
        for made in (self.backing, mount):
            made.mkdir(parents=True)
        server = Path(__file__).with_name("faulty_fs.py")
        self._process = subprocess.Popen(
            ["unshare", "--user", "--map-root-user", "--mount", sys.executable, server, self.backing, mount],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        if self._read() is None:
            why = self._process.stderr.read() if self._process.stderr else ""
            self._end()
            (pytest.fail if "CI" in os.environ else pytest.skip)(
                f"no FUSE file system of one's own here: {why.strip()}"
            )
        self.path = Path(f"/proc/{self._process.pid}/root{mount}")

    def arm(self, fault: Fault | None = None) -> Happened:
        """Make a fault happen from now on, instead of the one before; None lets everything go well."""
        return self._order(asdict(fault or Fault()))

    def power_cut(self, target: Path, how: str) -> None:
        """Write what a power cut now would leave to a new folder; ``how``: see `support.volatile`. Faults are over then."""
        self._order({"cut": str(target), "how": how})

    def _order(self, order: dict[str, Any]) -> Happened:
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(order) + "\n")
        self._process.stdin.flush()
        told = self._read()
        assert told is not None, "the faulty file system is gone"
        return Happened(told["changes"], told["fired"], told["room"] or 0)

    def _read(self) -> dict[str, Any] | None:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        return json.loads(line) if line else None

    def _end(self) -> None:
        self._process.kill()
        self._process.wait(timeout=10)
        for pipe in (self._process.stdin, self._process.stdout, self._process.stderr):
            if pipe is not None:
                pipe.close()

    def __enter__(self) -> FaultyFs:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._end()

    def clear(self) -> None:
        """No fault and no file."""
        self.arm()
        for found in self.backing.iterdir():
            shutil.rmtree(found)
        self._order({"forget": True})
