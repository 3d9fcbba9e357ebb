"""Where the emulated mirror really is: the stepper bench publishes it in a small memory-mapped file.

Layout: ``struct mirror_state`` in ``stepper_bench/bench.h``. One writer; any number of readers in other processes.
"""

from __future__ import annotations

import mmap
import struct
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

_LAYOUT = struct.Struct("<QqqQQqq")
_ATTEMPTS = 10_000


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
    """A reader of the mirror file. Cheap: `read` copies 56 bytes and makes no system call."""

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
        if len(memory) != _LAYOUT.size:
            length = len(memory)
            memory.close()
            raise ValueError(f"{path} is not a mirror file: its length is {length}, not {_LAYOUT.size} bytes")
        return cls(memory)

    def read(self) -> MirrorReading:
        """The present state.

        Raises:
            RuntimeError: The writer died in the middle of an update, so that no consistent state will ever appear.
        """
        for _ in range(_ATTEMPTS):
            before, *fields = _LAYOUT.unpack_from(self._memory)
            (after,) = struct.unpack_from("<Q", self._memory)
            if before == after and before % 2 == 0:
                return MirrorReading(*fields)
        raise RuntimeError("the mirror file stays inconsistent: the bench that wrote it is dead")

    def close(self) -> None:
        """Unmap the file. Safe to repeat."""
        self._memory.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
