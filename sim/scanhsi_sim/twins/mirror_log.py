"""Where the mirror was between two times: a log that a thread in C (``mirror_log.c``) keeps of the mirror file."""

import ctypes
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scanhsi_sim.twins import native

SIZE = 8192  # MIRROR_LOG_SIZE
_PUBLISHED_NS = 1_000_000  # a step is published up to 0.2 ms after it was made
_PATIENCE_S = 0.1

_Entry = ctypes.c_int64 * 2


def span_of(log: NDArray[np.int64], start_ns: int, end_ns: int) -> tuple[int, int]:
    """Lowest and highest position between two times; the same when the mirror stood still.

    Args:
        log: (changes, 2), oldest first: when the mirror came where. Before the first it is taken to have stood there.
        start_ns: A step at this time is over.
        end_ns: A step at this time counts.
    """
    first = max(0, int(np.searchsorted(log[:, 0], start_ns, side="right")) - 1)
    last = int(np.searchsorted(log[:, 0], end_ns, side="right"))
    positions = log[first : max(last, first + 1), 1]
    return int(positions.min()), int(positions.max())


class MirrorLog:
    """The log of one mirror; one a process."""

    def __init__(self, path: str | Path) -> None:
        """Begin to watch the file that a running stepper twin writes.

        Raises:
            FileNotFoundError: there is none.
            MissingRequirement: no C compiler.
        """
        library = native.load("mirror_log")
        if library.mirror_log_start(str(path).encode()) != 0:
            raise FileNotFoundError(f"no mirror file at {path}: is the stepper twin running?")
        self._count = ctypes.c_uint64.in_dll(library, "mirror_log_count")
        self._seen_ns = ctypes.c_int64.in_dll(library, "mirror_log_seen_ns")
        entries = (_Entry * SIZE).in_dll(library, "mirror_log")
        self._entries: NDArray[np.int64] = np.ctypeslib.as_array(entries)
        while self._count.value == 0:
            time.sleep(0.001)

    def span(self, start_ns: int, end_ns: int) -> tuple[int, int]:
        """Lowest and highest position, in steps, between two times (CLOCK_MONOTONIC); waits until the end is over."""
        give_up = time.monotonic_ns() + int(_PATIENCE_S * 1e9) + max(0, end_ns - time.monotonic_ns())
        while self._seen_ns.value < end_ns + _PUBLISHED_NS and time.monotonic_ns() < give_up:
            time.sleep(max(0.0003, (end_ns + _PUBLISHED_NS - time.monotonic_ns()) * 1e-9))
        count = self._count.value
        known = self._entries[:count] if count <= SIZE else np.roll(self._entries, -count, axis=0)
        return span_of(known, start_ns, end_ns)
