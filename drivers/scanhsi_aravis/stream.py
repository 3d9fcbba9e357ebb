"""The thread that takes finished buffers from Aravis and turns them into arrivals for the event loop.

A buffer counts as a frame only if Aravis calls it a success *and* it received exactly one payload: Aravis also calls a frame
that was cut to a smaller buffer a success. The frame id and the time stamps of anything else may be stale or zero and are not
read. Aravis' own counter of underruns counts packets, not frames, and is not used: lost frames show as gaps of frame ids.
"""

from __future__ import annotations

import ctypes
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanhsi_aravis.lib import Calls
from scanhsi_aravis.ring import Ring

POP_US = 50_000
"""How long one wait for a buffer lasts: the longest time that stopping takes."""

_SUCCESS = 0
_PROBLEMS = {
    2: "packets came too late",
    3: "packets were lost",
    4: "packets came in the wrong order",
    5: "the frame does not fit its buffer",
    7: "the stream was stopped",
}


@dataclass(slots=True)
class Arrival:
    """One buffer that Aravis finished; loop clock, ns.

    Attributes:
        received_ns: When the buffer was taken from Aravis.
        payload: Leased view of the pixels, or None when the frame is not whole; then only ``problem`` says something.
        problem: Why it is not whole.
        frame_id: As the camera counts.
        device_ns: The camera's time stamp, or None.
        stamped_ns: The same on the loop's clock, where the camera's clock is this computer's (a twin), or None.
        first_byte_ns: When the first packet came, or None.
    """

    received_ns: int
    payload: NDArray[np.uint8] | None = None
    problem: str = ""
    frame_id: int = 0
    device_ns: int | None = None
    stamped_ns: int | None = None
    first_byte_ns: int | None = None


class Receiver:
    """Runs the thread from construction to `stop`.

    Args:
        calls: The frame path of libaravis.
        stream: Address of the stream; has to outlive the thread.
        ring: Where the stream's buffers come from.
        deliver: Called in the thread with each arrival. RuntimeError (the event loop is closed) ends the thread.
    """

    def __init__(self, calls: Calls, stream: int, ring: Ring, deliver: Callable[[Arrival], object]) -> None:
        self._calls = calls
        self._stream = stream
        self._ring = ring
        self._deliver = deliver
        self._stopping = False
        self._thread = threading.Thread(target=self._run, name="aravis-frames", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Deliver what has been received and join the thread; takes up to 50 ms."""
        self._stopping = True
        self._thread.join()

    def _run(self) -> None:
        try:
            while not self._stopping:
                self._pop(POP_US)
            for _ in range(
                self._ring.count
            ):  # what was finished before the stop; a camera that goes on must not keep us
                self._pop(0)
        except RuntimeError:
            return  # the event loop is closed: nobody is left to tell

    def _pop(self, timeout_us: int) -> None:
        buffer = self._calls.pop(self._stream, timeout_us)
        if buffer:
            self._deliver(self._arrival(buffer, time.monotonic_ns()))

    def _arrival(self, buffer: int, now_ns: int) -> Arrival:
        calls = self._calls
        status = calls.buffer_status(buffer)
        received = ctypes.c_size_t()
        calls.buffer_data(buffer, ctypes.byref(received))
        if status != _SUCCESS or received.value != self._ring.payload_bytes:
            self._ring.give_back(buffer)
            problem = _PROBLEMS.get(status, f"Aravis gave it status {status}")
            if status == _SUCCESS:
                problem = f"{received.value} bytes came instead of {self._ring.payload_bytes}"
            return Arrival(now_ns, problem=problem)
        device_ns = calls.buffer_device_ns(buffer)
        return Arrival(
            now_ns,
            payload=self._ring.lease(buffer),
            frame_id=calls.buffer_frame_id(buffer),
            device_ns=device_ns or None,
            stamped_ns=_loop_ns(device_ns, now_ns),
            first_byte_ns=_loop_ns(calls.buffer_wall_ns(buffer), now_ns),
        )


def _loop_ns(wall_ns: int, now_ns: int) -> int | None:
    """A wall-clock stamp of the last 10 s on the loop's clock; None for what is no such stamp."""
    age_ns = time.time_ns() - wall_ns
    return now_ns - age_ns if 0 <= age_ns < 10_000_000_000 else None
