"""The ring, its leases and the receive thread, without Aravis."""

import gc
import mmap
import threading
import weakref
from itertools import pairwise

import numpy as np
import pytest
from aravis_doubles import STREAM, FakeStream

from scanhsi_aravis.ring import Ring
from scanhsi_aravis.stream import Arrival, Receiver

BYTES = 5000  # no multiple of a page


def pop(stream: FakeStream) -> int:
    return stream.done.get_nowait()


def test_all_buffers_are_free_at_the_start() -> None:
    stream = FakeStream()
    ring = Ring(stream.calls(), STREAM, BYTES, 3)
    assert len(stream.free) == 3
    assert not ring.exhausted
    addresses = sorted(buffer.address for buffer in stream.buffers.values())
    assert all(address % mmap.PAGESIZE == 0 for address in addresses)
    assert all(b - a >= BYTES for a, b in pairwise(addresses))


def test_a_view_is_read_only_and_no_copy() -> None:
    stream = FakeStream()
    ring = Ring(stream.calls(), STREAM, BYTES, 2)
    stream.complete(7)
    buffer = pop(stream)
    view = ring.lease(buffer)
    assert view.shape == (BYTES,)
    assert view.dtype == np.uint8
    assert (view == 7).all()
    assert view.ctypes.data == stream.buffers[buffer].address
    with pytest.raises(ValueError, match="read-only"):
        view[0] = 1
    with pytest.raises(ValueError, match="WRITEABLE"):
        view.flags.writeable = True


def test_the_buffer_goes_back_with_the_last_view_of_it() -> None:
    stream = FakeStream()
    ring = Ring(stream.calls(), STREAM, BYTES, 1)
    stream.complete(7)
    view = ring.lease(pop(stream))
    assert ring.exhausted
    corner = view[:16].view(np.uint16).reshape(2, 4)[1:]
    del view
    assert not stream.free
    assert not stream.complete(8), "a frame was written over one that is still in use"
    assert (corner == 0x0707).all()
    assert not ring.heard_again_ns
    del corner
    assert len(stream.free) == 1
    assert not ring.exhausted
    assert ring.heard_again_ns > 0


def test_a_view_dies_in_another_thread() -> None:
    stream = FakeStream()
    ring = Ring(stream.calls(), STREAM, BYTES, 1)
    stream.complete(7)
    box = [ring.lease(pop(stream))]
    thread = threading.Thread(target=box.clear)
    thread.start()
    thread.join()
    assert len(stream.free) == 1


def test_views_outlive_the_stream_and_then_the_memory_goes() -> None:
    stream = FakeStream()
    ring = Ring(stream.calls(), STREAM, BYTES, 2)
    stream.complete(7)
    buffer = pop(stream)
    view = ring.lease(buffer)
    ring.close()
    ring.close()
    stream.freed = True
    gone, lease_gone = weakref.ref(ring), weakref.ref(view.base)  # pyright: ignore[reportArgumentType]
    del ring
    gc.collect()
    assert gone() is not None
    assert (view == 7).all()
    del view
    assert lease_gone() is None
    assert gone() is None
    assert stream.unrefs == {buffer: 1}, "the buffer that nobody can take back is freed once"


def test_memory_is_mapped_as_long_as_it_is_used() -> None:
    def mapped() -> int:
        with open("/proc/self/statm") as statm:
            return int(statm.read().split()[0]) * mmap.PAGESIZE

    size, rounds = 4 << 20, 10
    before = mapped()
    for _ in range(rounds):
        stream = FakeStream()
        ring = Ring(stream.calls(), STREAM, size, 4)
        stream.complete(1)
        view = ring.lease(pop(stream))
        ring.close()
        del ring, view, stream
    assert mapped() - before < 2 * 4 * size


class Inbox:
    """Where a `Receiver` delivers."""

    def __init__(self) -> None:
        self.arrivals: list[Arrival] = []
        self._came = threading.Condition()

    def __call__(self, arrival: Arrival) -> None:
        with self._came:
            self.arrivals.append(arrival)
            self._came.notify()

    def wait_for(self, count: int) -> list[Arrival]:
        with self._came:
            assert self._came.wait_for(lambda: len(self.arrivals) >= count, timeout=10)
            return list(self.arrivals)


def test_only_whole_frames_are_frames() -> None:
    stream, inbox = FakeStream(), Inbox()
    ring = Ring(stream.calls(), STREAM, BYTES, 4)
    receiver = Receiver(stream.calls(), STREAM, ring, inbox)
    stream.complete(1, frame_id=11)
    stream.complete(2, frame_id=12, status=3)
    stream.complete(3, frame_id=13, short_by=1)
    stream.complete(4, frame_id=14, status=99)
    whole, lost, short, odd = inbox.wait_for(4)
    receiver.stop()
    assert whole.payload is not None
    assert (whole.payload == 1).all()
    assert whole.frame_id == 11
    assert whole.device_ns is None
    assert whole.first_byte_ns is not None
    assert 1_900_000 < whole.received_ns - whole.first_byte_ns < 2_000_000_000
    assert (lost.payload, lost.problem) == (None, "packets were lost")
    assert (short.payload, short.problem) == (None, f"{BYTES - 1} bytes came instead of {BYTES}")
    assert odd.payload is None
    assert "99" in odd.problem
    assert len(stream.free) == 3, "buffers of broken frames go back at once"


def test_stopping_delivers_what_has_come_and_ends_the_thread() -> None:
    stream, inbox = FakeStream(), Inbox()
    ring = Ring(stream.calls(), STREAM, BYTES, 3)
    before = threading.active_count()
    receiver = Receiver(stream.calls(), STREAM, ring, inbox)
    for value in range(3):
        stream.complete(value)
    receiver.stop()
    assert len(inbox.arrivals) == 3
    assert threading.active_count() == before


def test_the_thread_ends_when_nobody_listens_any_more() -> None:
    def closed_loop(_: Arrival) -> None:
        raise RuntimeError("Event loop is closed")

    stream = FakeStream()
    ring = Ring(stream.calls(), STREAM, BYTES, 1)
    receiver = Receiver(stream.calls(), STREAM, ring, closed_loop)
    stream.complete(1)
    receiver.stop()
    assert len(stream.free) == 1
