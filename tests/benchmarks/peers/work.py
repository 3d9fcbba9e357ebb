"""The work that every peer does, and the watch that every peer is timed with."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import zarr

SHAPE = (64, 512)
"""Rows and columns of a frame; of 16-bit pixels."""
BLOCK = 32
"""Lines of a Zarr chunk (2 MiB) where the peer brings no writer of its own."""

_DIFFERENT = 8


@dataclass(frozen=True)
class Work:
    """A step scan: for each line move to the next step, then expose. Neither takes time.

    Attributes:
        lines: How many.
        store: Zarr group or array to create, with a frame a line in it; None: no pixels are kept, and none made where that goes.
    """

    lines: int
    store: Path | None


@dataclass
class Watch:
    """Takes the time of a scan.

    Attributes:
        ends_ns: When each line's exposure was over.
        wall_ns, cpu_ns: The whole scan, its opening and closing included; CPU time of all threads.
    """

    ends_ns: list[int] = field(default_factory=list)
    wall_ns: int = 0
    cpu_ns: int = 0

    def line_over(self, *_: object) -> None:
        self.ends_ns.append(time.perf_counter_ns())

    @contextmanager
    def running(self) -> Iterator[None]:
        cpu_ns, wall_ns = time.process_time_ns(), time.perf_counter_ns()
        yield
        self.wall_ns, self.cpu_ns = time.perf_counter_ns() - wall_ns, time.process_time_ns() - cpu_ns


Scan = Callable[[Work, Watch], "np.ndarray | None"]
"""What a peer's module offers: do the work within ``watch.running()``, then return what was stored as (line, row, column)."""


def make_frames() -> np.ndarray:
    """Eight different 12-bit frames, made beforehand: (8, row, column) uint16."""
    return np.random.default_rng(1).integers(0, 4096, (_DIFFERENT, *SHAPE), np.uint16)


def expected(lines: int) -> np.ndarray:
    """What must have been stored: (line, row, column)."""
    return make_frames()[np.arange(lines) % _DIFFERENT]


class Blocks:
    """Stores frames through zarr-python, some lines at a time, uncompressed: for peers that bring no Zarr writer."""

    def __init__(self, path: Path, lines: int) -> None:
        self._array = zarr.create_array(
            path, shape=(lines, *SHAPE), dtype="uint16", chunks=(BLOCK, *SHAPE), compressors=None, overwrite=True
        )
        self._lines = lines
        self._block = np.empty((BLOCK, *SHAPE), np.uint16)

    def add(self, line: int, frame: np.ndarray) -> None:
        """Take a frame; the last one of a block writes it."""
        self.take(line, frame)
        if self.full(line):
            self.write(line, self._block)

    def take(self, line: int, frame: np.ndarray) -> None:
        np.copyto(self._block[line % BLOCK], frame)

    def full(self, line: int) -> bool:
        return line % BLOCK == BLOCK - 1 or line == self._lines - 1

    def swap(self) -> np.ndarray:
        """Give the full block away, to be written elsewhere, and go on with another."""
        block, self._block = self._block, np.empty((BLOCK, *SHAPE), np.uint16)
        return block

    def write(self, line: int, block: np.ndarray) -> None:
        """Write the block that ends with ``line``."""
        first = line - line % BLOCK
        self._array[first : line + 1] = block[: line + 1 - first]

    def read(self) -> np.ndarray:
        return self._array[:]
