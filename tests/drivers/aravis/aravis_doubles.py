"""A stream in plain Python behind the driver's table of C functions: what the ring and the receive thread call."""

import ctypes
import queue
import time
from collections import Counter
from dataclasses import dataclass, field
from typing import Any

from scanhsi_aravis.lib import Calls

STREAM = 1


@dataclass
class Buffer:
    """One buffer over the ring's memory."""

    size: int
    address: int
    status: int = 0
    received: int = 0
    frame_id: int = 0


@dataclass
class FakeStream:
    """Keeps what was pushed; `complete` fills the oldest buffer as a camera would."""

    buffers: dict[int, Buffer] = field(default_factory=dict[int, Buffer])
    free: list[int] = field(default_factory=list[int])
    done: "queue.SimpleQueue[int]" = field(default_factory=lambda: queue.SimpleQueue())
    unrefs: Counter[int] = field(default_factory=Counter[int])
    freed: bool = False

    def complete(self, value: int, *, frame_id: int = 1, status: int = 0, short_by: int = 0) -> bool:
        """A frame full of `value` comes; False if no buffer is free."""
        if not self.free:
            return False
        pointer = self.free.pop(0)
        buffer = self.buffers[pointer]
        ctypes.memset(buffer.address, value, buffer.size)
        buffer.status, buffer.received, buffer.frame_id = status, buffer.size - short_by, frame_id
        self.done.put(pointer)
        return True

    def calls(self) -> Calls:
        return Calls(
            buffer_new=self._new,
            buffer_status=lambda pointer: self.buffers[pointer].status,
            buffer_frame_id=lambda pointer: self.buffers[pointer].frame_id,
            buffer_device_ns=lambda pointer: 0,
            buffer_wall_ns=lambda pointer: time.time_ns() - 2_000_000,
            buffer_data=self._data,
            push=self._push,
            pop=self._pop,
            ref=lambda pointer: pointer,
            unref=self._unref,
            release=self._unref,
        )

    def _new(self, size: int, address: int) -> int:
        pointer = 1000 + len(self.buffers)
        self.buffers[pointer] = Buffer(size, address)
        ctypes.memset(address, 0, size)  # mapped and writable, or this is a crash
        return pointer

    def _push(self, stream: int, pointer: int) -> None:
        assert stream == STREAM
        assert not self.freed, "pushed to a stream that is gone"
        assert pointer not in self.free, "pushed twice"
        self.free.append(pointer)

    def _pop(self, stream: int, timeout_us: int) -> int | None:
        assert stream == STREAM
        try:
            return self.done.get(timeout=timeout_us * 1e-6) if timeout_us else self.done.get_nowait()
        except queue.Empty:
            return None

    def _unref(self, pointer: int) -> None:
        self.unrefs[pointer] += 1

    def _data(self, pointer: int, size: Any) -> int:
        size._obj.value = self.buffers[pointer].received
        return self.buffers[pointer].address
