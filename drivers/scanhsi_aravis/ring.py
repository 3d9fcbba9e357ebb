"""A ring of frame buffers in memory of our own, and the leases on it that frames are.

Aravis writes into the ring; a frame's pixels are a read-only view of one slot. The view's base is a `_Lease`, and when the last
view or slice dies, in whatever thread, the slot goes back to the stream. Memory is freed when both the stream and the last
view are gone: views refer to the ring, the ring to the memory, and nobody unmaps by hand.
"""

from __future__ import annotations

import ctypes
import mmap
import threading
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanhsi_aravis.lib import Calls


class Ring:
    """``count`` buffers of exactly ``payload_bytes`` each, pushed to ``stream``; `close` takes them out of its reach.

    Args:
        calls: The frame path of libaravis.
        stream: Address of the stream; the caller frees it, after `close`.
        payload_bytes: Size of a frame on the wire: Aravis reports success for a buffer that was too small.
        count: Number of buffers.

    Attributes:
        heard_again_ns: When the first buffer came back after consumers had held all of them, CLOCK_MONOTONIC.
    """

    def __init__(self, calls: Calls, stream: int, payload_bytes: int, count: int) -> None:
        self.payload_bytes = payload_bytes
        self.count = count
        self._push, self._unref = calls.push, calls.unref
        self._stream: int | None = stream
        self._leased = 0
        self.heard_again_ns = 0
        # Re-entrant: the garbage collector may end a lease while this thread holds the lock.
        self._lock = threading.RLock()
        slot = -(-payload_bytes // mmap.PAGESIZE) * mmap.PAGESIZE
        # Touched now: page faults in the receive thread would cost the first frames.
        flags = mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS | getattr(mmap, "MAP_POPULATE", 0)
        self._memory = ctypes.c_char.from_buffer(mmap.mmap(-1, slot * count, flags=flags))
        start = ctypes.addressof(self._memory)
        self._address = {calls.buffer_new(payload_bytes, start + i * slot): start + i * slot for i in range(count)}
        for buffer in self._address:
            self._push(stream, buffer)

    def lease(self, buffer: int) -> NDArray[np.uint8]:
        """A read-only view of a popped buffer; the buffer goes back when the view's last descendant dies."""
        with self._lock:
            self._leased += 1
        return np.asarray(_Lease(self, buffer, self._address[buffer]))

    @property
    def exhausted(self) -> bool:
        """Whether consumers hold every buffer, so that no frame can be received."""
        return self._leased >= self.count

    def end_lease(self, buffer: int) -> None:
        """The last view of a buffer died."""
        with self._lock:
            if self.exhausted:
                self.heard_again_ns = time.monotonic_ns()
            self._leased -= 1
            self.give_back(buffer)

    def give_back(self, buffer: int) -> None:
        """Return a popped buffer: to the stream, or to nobody when that is gone. From any thread."""
        with self._lock:
            if self._stream is None:
                self._unref(buffer)
            else:
                self._push(self._stream, buffer)

    def close(self) -> None:
        """Forget the stream, before it is freed. Leases that are still out stay readable. Idempotent."""
        with self._lock:
            self._stream = None


class _Lease:
    """One popped buffer, as numpy sees memory. Owns it: dies with the last view."""

    __slots__ = ("__array_interface__", "__weakref__", "_buffer", "_ring")

    def __init__(self, ring: Ring, buffer: int, address: int) -> None:
        self._ring = ring
        self._buffer = buffer
        self.__array_interface__: dict[str, Any] = {
            "version": 3,
            "shape": (ring.payload_bytes,),
            "typestr": "|u1",
            "data": (address, True),
        }

    def __del__(self) -> None:
        self._ring.end_lease(self._buffer)
