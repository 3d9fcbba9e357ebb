"""Frames: what a camera delivers, how it reports what it could not deliver, and the channel between the two.

A *frame* is one read-out of the sensor: ``(bands, samples)`` pixels, one spatial line with its spectrum. Frames of one
``arm()`` are counted from 0 in the order of their exposures; ``index`` is that count, already freed of whatever the camera's
own ``frame_id`` does (16-bit wrap-around, skipped zero, arbitrary start).
"""

from __future__ import annotations

import asyncio
from collections import deque
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from scanhsi.devices.pixels import PixelFormat

Pixels = NDArray[np.uint8] | NDArray[np.uint16]


@dataclass(slots=True)
class Frame:
    """One complete frame, still in the camera's own buffer.

    Attributes:
        index: Exposures since ``arm()``, from 0.
        frame_id: The camera's own number for it.
        payload: Read-only bytes as they came over the wire, 1-D uint8, zero-copy. The buffer goes back to the camera when the
            last view of it dies, so a consumer that wants to keep pixels copies them (``Camera.unpack``) and lets go.
            None where a simulated camera has not been asked to render.
        pixel_format: How the pixels lie in ``payload``.
        shape: (bands, samples).
        received_ns: When the last byte was in memory, loop clock.
        device_ns: The camera's own time stamp, its own epoch; None without one.
        first_byte_ns: When the first byte arrived, loop clock; None where unknown.
        exposure_start_ns: Start of exposure, loop clock, where the driver can tell. The engine needs it only for exposures
            that it did not trigger itself (hardware trigger, free run).
    """

    index: int
    frame_id: int
    payload: NDArray[np.uint8] | None
    pixel_format: PixelFormat
    shape: tuple[int, int]
    received_ns: int
    device_ns: int | None = None
    first_byte_ns: int | None = None
    exposure_start_ns: int | None = None


@dataclass(frozen=True, slots=True)
class FrameGap:
    """Frames that were exposed and will never arrive whole. Reported in order, never skipped in silence.

    Attributes:
        first: Index of the first lost frame.
        count: How many in a row.
        reason: One sentence (``"3 packets missing"``, ``"no free buffer"``, ``"trigger came while the sensor was busy"``).
    """

    first: int
    count: int
    reason: str


FrameEvent = Frame | FrameGap


class FrameStream(Protocol):
    """What ``Camera.frames()`` returns: an asynchronous iterator of frames and gaps, in order of ``index``.

    It ends (``StopAsyncIteration``) after ``disarm()``, raises the camera's error when the camera fails, and cancelling a pending
    ``__anext__`` (a deadline, say) loses no frame. One consumer.
    """

    def __aiter__(self) -> FrameStream: ...

    async def __anext__(self) -> FrameEvent: ...


class FrameChannel:
    """A ready-made `FrameStream` for drivers: put frames in from the event loop, the engine takes them out.

    It holds whatever the camera's ring holds and no more: the number of buffers given to ``arm()`` bounds it.
    """

    def __init__(self) -> None:
        self._events: deque[FrameEvent] = deque()
        self._waiter: asyncio.Future[Any] | None = None
        self._closed = False
        self._error: BaseException | None = None

    def __aiter__(self) -> FrameChannel:
        return self

    def __len__(self) -> int:
        """Frames and gaps waiting to be taken."""
        return len(self._events)

    def put(self, event: FrameEvent) -> None:
        """Hand over a frame or a gap. From the event loop's thread only; after `close` or `fail` it is let go."""
        if not self._closed:
            self._events.append(event)
            self._wake()

    def close(self) -> None:
        """No more frames: the consumer gets what is queued and then the end. Idempotent."""
        self._closed = True
        self._wake()

    def fail(self, error: BaseException) -> None:
        """The camera failed: the consumer gets what is queued and then ``error``. The first error wins."""
        if not self._closed:
            self._error = error
            self.close()

    async def __anext__(self) -> FrameEvent:
        while not self._events:
            if self._error is not None:
                raise self._error
            if self._closed:
                raise StopAsyncIteration
            if self._waiter is not None:
                raise RuntimeError("a frame stream has one consumer")
            self._waiter = asyncio.get_running_loop().create_future()
            try:
                await self._waiter
            finally:
                self._waiter = None
        return self._events.popleft()

    def _wake(self) -> None:
        if self._waiter is not None and not self._waiter.done():
            self._waiter.set_result(None)
