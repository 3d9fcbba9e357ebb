"""Where the emulated mirror really is: the stepper bench publishes it in a small memory-mapped file.

Layout: ``struct mirror_state`` in ``stepper_bench/bench.h``. One writer; any number of readers in other processes.
"""

from __future__ import annotations

import mmap
import struct
import time
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

HISTORY = 8192
"""Changes of position that the file remembers (``MIRROR_HISTORY``)."""
HEAD = struct.Struct("<QqqQQqqqQ")
SIZE = HEAD.size + 16 * HISTORY
_COMPLETE = 7
_CHANGES = 8
_ATTEMPTS = 10_000
_PATIENCE_S = 0.5


@dataclass(frozen=True, slots=True)
class MirrorReading:
    """One consistent snapshot of the mirror.

    Attributes:
        position_steps: Of the mirror itself, unwrapped; 0 is the home index edge, whatever the firmware counts.
        last_step_host_ns: CLOCK_MONOTONIC when the mirror last moved, on the bench's paced clock; 0 = not since it started. It
            can be read here up to 0.2 ms later, and later still when the host stalls.
        step_count: Steps the mirror has made, both directions together.
        trig_count: Trigger pulses since the bench started.
        last_trig_position: Position at the last pulse.
        last_trig_host_ns: CLOCK_MONOTONIC of the last pulse; 0 = none yet.
    """

    position_steps: int
    last_step_host_ns: int
    step_count: int
    trig_count: int
    last_trig_position: int
    last_trig_host_ns: int

    def wrapped(self, steps_per_turn: int = 19_200) -> int:
        """Position within the turn around home: from ``-steps_per_turn // 2`` up to, not including, its positive."""
        half = steps_per_turn // 2
        return (self.position_steps + half) % steps_per_turn - half


class MirrorState:
    """A reader of the mirror file. Cheap: `read` copies 72 bytes and makes no system call."""

    def __init__(self, memory: mmap.mmap) -> None:
        self._memory = memory

    @classmethod
    def open(cls, path: str | Path) -> Self:
        """Map the file that a running bench writes (`StepperTwin.mirror_file`).

        Raises:
            FileNotFoundError: No bench has made it.
            ValueError: It is not such a file.
        """
        with Path(path).open("rb") as file:
            memory = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        if len(memory) != SIZE:
            length = len(memory)
            memory.close()
            raise ValueError(f"{path} is not a mirror file: its length is {length}, not {SIZE} bytes")
        return cls(memory)

    def read(self) -> MirrorReading:
        """The present state.

        Raises:
            RuntimeError: The writer died in the middle of an update, so that no consistent state will ever appear.
        """
        for _ in range(_ATTEMPTS):
            before, *fields = HEAD.unpack_from(self._memory)
            (after,) = struct.unpack_from("<Q", self._memory)
            if before == after and before % 2 == 0:
                return MirrorReading(*fields[:6])
        raise RuntimeError("the mirror file stays inconsistent: the bench that wrote it is dead")

    def span(self, start_ns: int, end_ns: int) -> tuple[int, int]:
        """Lowest and highest position, in steps, that the mirror had between two times; the same when it stood still.

        Waits until all that happened until ``end_ns`` is published; half a second at most, for a bench that has died.

        Args:
            start_ns: CLOCK_MONOTONIC; a step at this time is over.
            end_ns: CLOCK_MONOTONIC; a step at this time counts.
        """
        give_up = time.monotonic() + _PATIENCE_S + max(0.0, end_ns * 1e-9 - time.monotonic())
        while self._head(_COMPLETE) < end_ns and time.monotonic() < give_up:
            time.sleep(max(0.0002, end_ns * 1e-9 - time.monotonic()))
        return span_of(self._history(), start_ns, end_ns)

    def _head(self, field: int) -> int:
        return int(HEAD.unpack_from(self._memory)[field])

    def _history(self) -> NDArray[np.int64]:
        """(changes, 2), oldest first: when the mirror came where."""
        known = self._head(_CHANGES)
        ring = np.frombuffer(self._memory[HEAD.size :], np.int64).reshape(HISTORY, 2)
        overwritten = max(0, self._head(_CHANGES) + 1 - HISTORY)  # one more may be under way
        return ring[np.arange(min(overwritten, known), known) % HISTORY]

    def close(self) -> None:
        """Unmap the file. Safe to repeat."""
        self._memory.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def span_of(history: NDArray[np.int64], start_ns: int, end_ns: int) -> tuple[int, int]:
    """Lowest and highest position between two times; before the first change the mirror is taken to have stood there.

    Args:
        history: (changes, 2), oldest first: when (ns) the mirror came where (steps).
        start_ns: A step at this time is over.
        end_ns: A step at this time counts.
    """
    first = max(0, int(np.searchsorted(history[:, 0], start_ns, side="right")) - 1)
    last = int(np.searchsorted(history[:, 0], end_ns, side="right"))
    positions = history[first : max(last, first + 1), 1]
    return int(positions.min()), int(positions.max())
