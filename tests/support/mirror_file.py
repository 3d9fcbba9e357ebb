"""A mirror that a test moves by hand: writes the file that the stepper's twin writes (``struct mirror_state``)."""

import mmap
import struct
import time
from pathlib import Path

_LAYOUT = struct.Struct("<QqqQQqq")


class MirrorFile:
    """The file, and the mirror's position in it."""

    def __init__(self, path: Path, position: int = 0) -> None:
        self.path = path
        path.write_bytes(bytes(_LAYOUT.size))
        with path.open("r+b") as file:
            self._memory = mmap.mmap(file.fileno(), _LAYOUT.size)
        self._position, self._count, self._sequence = position, 0, 0
        self._write(last_step_ns=0)

    def move_to(self, position: int) -> None:
        """Move the mirror there, at once."""
        self._count += abs(position - self._position)
        self._position = position
        self._write(last_step_ns=time.monotonic_ns())

    def _write(self, last_step_ns: int) -> None:
        self._sequence += 2
        self._memory[8:] = _LAYOUT.pack(0, self._position, last_step_ns, self._count, 0, 0, 0)[8:]
        self._memory[:8] = struct.pack("<Q", self._sequence)
