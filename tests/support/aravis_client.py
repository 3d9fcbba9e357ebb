"""A bare Aravis client: no driver of ours, so that the camera's twin is tested for what it is. Only inside `twin` tests."""

import ctypes
import warnings
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

_PACKET_BYTES = 9000
_SOCKET_BYTES = 8 << 20


@dataclass
class Received:
    """One frame as it came over the wire, good or not."""

    good: bool
    payload: NDArray[np.uint8]
    frame_id: int
    timestamp_ns: int


@dataclass
class Client:
    """An armed camera.

    Aravis closes stream and camera, in this order, as the last references to them go. So nothing but this object holds
    them, and it lets go at the end, whatever traceback of a failed test still holds this object.
    """

    aravis: Any
    camera: Any
    stream: Any = None

    def trigger(self) -> None:
        self.camera.software_trigger()

    def receive(self, timeout_s: float = 5.0) -> Received | None:
        """The next frame, or None if none comes in time."""
        buffer = self.stream.timeout_pop_buffer(int(timeout_s * 1e6))
        if buffer is None:
            return None
        good = buffer.get_status() == self.aravis.BufferStatus.SUCCESS
        payload = np.frombuffer(buffer.get_data(), np.uint8).copy() if good else np.empty(0, np.uint8)
        received = Received(good, payload, buffer.get_frame_id(), buffer.get_timestamp())
        self.stream.push_buffer(buffer)
        return received

    def shoot(self, timeout_s: float = 5.0) -> NDArray[np.uint8]:
        """Trigger, and the good payload that comes of it."""
        self.trigger()
        received = self.receive(timeout_s)
        assert received is not None, "no frame came"
        assert received.good, "the frame is incomplete"
        return received.payload


def load() -> tuple[Any, Any]:
    """The Aravis and GLib modules of PyGObject."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ImportWarning)  # PyGObject's own, of its importer
        import gi

        gi.require_version("Aravis", "0.8")
        return import_module("gi.repository.Aravis"), import_module("gi.repository.GLib")


@contextmanager
def opened() -> Generator[Client]:
    """The twin's camera, under control, ranges checked, not armed."""
    aravis, _ = load()
    client = Client(aravis, aravis.Camera.new("127.0.0.1"))
    client.camera.set_range_check_policy(aravis.RangeCheckPolicy.ENABLE)
    try:
        yield client
    finally:
        client.stream = None
        client.camera = None


@contextmanager
def armed(
    *,
    pixel_format: str = "Mono8",
    region: tuple[int, int, int, int] = (0, 0, 64, 32),
    exposure_us: float = 1000.0,
    source: str | None = "Software",
    rate_hz: float | None = None,
    buffers: int = 8,
) -> Generator[Client]:
    """Open, configure and arm the camera; region is (x, y, width, height). Source None: free run at `rate_hz`."""
    with opened() as client:
        _configure(client.camera, pixel_format, region, exposure_us, source, rate_hz)
        client.stream = _open_stream(client.camera)
        for _ in range(buffers):
            client.stream.push_buffer(client.aravis.Buffer.new_allocate(client.camera.get_payload()))
        client.camera.start_acquisition()
        try:
            yield client
        finally:
            client.camera.stop_acquisition()


def _configure(
    camera: Any,
    pixel_format: str,
    region: tuple[int, int, int, int],
    exposure_us: float,
    source: str | None,
    rate_hz: float | None,
) -> None:
    camera.stop_acquisition()
    camera.set_region(*region)
    camera.set_pixel_format_from_string(pixel_format)
    if rate_hz is not None:
        camera.set_frame_rate(rate_hz)
    camera.gv_set_packet_size(_PACKET_BYTES)
    camera.set_exposure_time(exposure_us)
    camera.set_string("TriggerMode", "Off" if source is None else "On")
    if source is not None:
        camera.set_string("TriggerSource", source)


def _open_stream(camera: Any) -> Any:
    """A stream with a fixed socket buffer and no resends."""
    stream = camera.create_stream(None, None)
    fixed, size, never = ctypes.c_int(0), ctypes.c_int(_SOCKET_BYTES), ctypes.c_int(0)
    ctypes.CDLL("libgobject-2.0.so.0").g_object_set(
        *(ctypes.c_void_p(hash(stream)), b"socket-buffer", fixed, b"socket-buffer-size", size),
        *(b"packet-resend", never, None),
    )
    return stream
