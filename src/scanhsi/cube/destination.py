"""Where the files of a cube go: a few operations on keys, so that a folder and an object store look alike to the writer.

A *key* is a path inside the cube with ``/`` (``cube/c/0/3/0``). Every method blocks and is called from threads, `Destination.put`
from two at once. Every error is an `OSError`; one with ``errno`` tells what (ENOSPC: full, EACCES: not allowed, ...).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Protocol


class DestinationError(OSError):
    """An error that knows what to try; shown to the user as it is.

    Args:
        number: As ``errno``.
        text: What happened, harmless: no credentials, no words of a server.
        hint: What to try.
    """

    def __init__(self, number: int, text: str, *, hint: str) -> None:
        super().__init__(number, text)
        self.hint = hint


class Destination(Protocol):
    """One cube's place; `scanhsi.cube.durable.LocalDestination` is the one for folders."""

    @property
    def name(self) -> str:
        """Path or URL, for people."""
        ...

    def create(self, files: Mapping[str, bytes]) -> None:
        """Create the cube with its first files and lock it, as `lock` does. All of it appears, or nothing does.

        Raises:
            FileExistsError: Something is there already; it was not touched.
            NotADirectoryError: There is no place (folder, bucket) to create it in.
        """
        ...

    def lock(self) -> None:
        """Keep other writers out until `unlock`, or the end of the process, and remove what a killed one left half-written.

        Raises:
            BlockingIOError: Somebody writes it now.
            FileNotFoundError: Nothing is there.
        """
        ...

    def unlock(self) -> None:
        """Let other writers in. Idempotent."""
        ...

    def put(self, key: str, parts: Sequence[memoryview], *, durable: bool) -> None:
        """Write one key whole: whatever happens, it holds the old contents or all of the new.

        Args:
            key: What to write.
            parts: Its contents in pieces. The pieces of a shard lie at multiples of 4096 in memory and are multiples of 4096 long.
            durable: The new contents survive a power cut once this returns; else once `settle` has returned.
        """
        ...

    def put_all(self, files: Mapping[str, bytes], *, durable: bool) -> None:
        """`put` of several small keys in any order, all of them done on return. Where it fails, some may have been written."""
        ...

    def settle(self) -> None:
        """Make every `put` survive a power cut."""
        ...

    def get(self, key: str) -> bytes | None:
        """Contents of a key; None where there is none."""
        ...

    def keys(self, prefix: str) -> list[str]:
        """Keys below a prefix that ends at a ``/`` (not included): ``keys("cube/c")``. Nothing half-written."""
        ...

    def delete(self, keys: Iterable[str]) -> None:
        """Remove keys; those that are not there do not matter."""
        ...

    def free_bytes(self) -> int | None:
        """Room left, for messages; None where nobody knows."""
        ...
