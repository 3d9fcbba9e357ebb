"""A mirror that a test moves by hand: writes the file that the stepper's twin writes (``struct mirror_state``)."""

import mmap
import struct
import time
from pathlib import Path

from scanhsi_sim.twins.mirror import HEAD, HISTORY, SIZE

_ALWAYS_COMPLETE = 2**63 - 1


class MirrorFile:
    """The file, and the mirror's position in it."""

    def __init__(self, path: Path, position: int = 0) -> None:
        self.path = path
        path.write_bytes(bytes(SIZE))
        with path.open("r+b") as file:
            self._memory = mmap.mmap(file.fileno(), 0)
        self._position, self._count, self._sequence, self._changes = position, 0, 0, 0
        self._write(0)

    def move_to(self, position: int) -> None:
        """Move the mirror there, at once."""
        self._count += abs(position - self._position)
        self._position = position
        self._write(time.monotonic_ns())

    def _write(self, host_ns: int) -> None:
        entry = HEAD.size + 16 * (self._changes % HISTORY)
        self._memory[entry : entry + 16] = struct.pack("<qq", host_ns, self._position)
        self._changes += 1
        self._sequence += 1
        self._memory[:8] = struct.pack("<Q", self._sequence)  # odd: at work
        fields = (self._position, host_ns, self._count, 0, 0, 0, _ALWAYS_COMPLETE, self._changes)
        self._memory[8 : HEAD.size] = HEAD.pack(0, *fields)[8:]
        self._sequence += 1
        self._memory[:8] = struct.pack("<Q", self._sequence)
