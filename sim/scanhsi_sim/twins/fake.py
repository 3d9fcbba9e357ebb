"""Aravis' in-library fake GigE Vision camera, through ctypes: registers, and frames whose pixels we supply.

Only the wire is Aravis': it answers GVCP, keeps the registers and sends what `FakeCamera.post` hands it. Exposure and
triggers are the twin's own (`scanhsi_sim.twins.sensor`).
"""

import ctypes
import os
import socket
import threading
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanhsi_sim.twins import native
from scanhsi_sim.twins.gvcp import PORT as GVCP_PORT

_FILL = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_uint32, ctypes.c_uint32, ctypes.c_uint32)
_TRIGGER_MODE, _TRIGGER_SOURCE, _TRIGGER_SOFTWARE = 0x300, 0x304, 0x30C  # the fake's own; the client never sees them


class FakeCamera:
    """The wire side of the camera twin: registers over GVCP, frames over GVSP.

    Attributes:
        sent: Frames sent.
        dropped: Frames lost on purpose.
        packet_loss: Part of the packets that are lost, 0 to 1, each by chance.
    """

    def __init__(self, address: str, serial: str, genicam: Path) -> None:
        """Start to answer at `address` (of this network namespace).

        Raises:
            native.MissingRequirement: no libaravis, or no C compiler.
            OSError: the address or its GVCP port is not free.
        """
        _check_free(address)
        event_poll = native.load("event_poll", for_all=True)  # before libaravis, so that it wins
        self._wake = os.eventfd(0, os.EFD_CLOEXEC | os.EFD_NONBLOCK)
        ctypes.c_int.in_dll(event_poll, "event_poll_fd").value = self._wake
        self._frozen = ctypes.c_int.in_dll(event_poll, "event_poll_frozen")
        self._aravis = _load_aravis()
        self._gobject = ctypes.CDLL("libgobject-2.0.so.0")
        self._camera = ctypes.c_void_p(
            self._aravis.arv_gv_fake_camera_new_full(address.encode(), serial.encode(), str(genicam).encode())
        )
        if not self._aravis.arv_gv_fake_camera_is_running(self._camera):
            raise OSError(
                f"the camera twin cannot listen at {address}: is another one running in this network namespace?"
            )
        self._registers = ctypes.c_void_p(self._aravis.arv_gv_fake_camera_get_fake_camera(self._camera))
        self._payload: NDArray[np.uint8] | None = None
        self._timestamp_ns = 0
        self._taken = threading.Event()
        self._drops = 0
        self.sent = 0
        self.dropped = 0
        self.packet_loss = 0.0
        self._fill_reference = _FILL(self._fill)  # the library keeps only the address
        self._aravis.arv_fake_camera_set_fill_pattern(self._registers, self._fill_reference, None)
        self._aravis.arv_fake_camera_set_trigger_frequency(self._registers, 1e6)  # waits are event_poll.c's
        self.write(_TRIGGER_MODE, 1)
        self.write(_TRIGGER_SOURCE, 1)

    def read(self, address: int) -> int:
        """A 32-bit register."""
        value = ctypes.c_uint32()
        self._aravis.arv_fake_camera_read_register(self._registers, address, ctypes.byref(value))
        return value.value

    def write(self, address: int, value: int) -> None:
        """Set a 32-bit register."""
        self._aravis.arv_fake_camera_write_register(self._registers, address, value)

    def write_text(self, address: int, text: str) -> None:
        """Set a zero-terminated text."""
        data = text.encode() + b"\0"
        self._aravis.arv_fake_camera_write_memory(self._registers, address, len(data), data)

    def post(self, payload: NDArray[np.uint8], timestamp_ns: int) -> None:
        """Have one frame sent.

        Args:
            payload: 1-D, contiguous, exactly the bytes that the present registers call for.
            timestamp_ns: Device timestamp, CLOCK_REALTIME.
        """
        self._taken.clear()
        self._payload, self._timestamp_ns = payload, timestamp_ns
        self.write(_TRIGGER_SOFTWARE, 1)
        os.eventfd_write(self._wake, 1)

    def wait_taken(self) -> None:
        """Wait until the frame is on its way (its packets are still going out) or withdrawn."""
        self._taken.wait()

    def withdraw(self) -> None:
        """Forget a frame that is not yet on its way."""
        self.write(_TRIGGER_SOFTWARE, 0)
        self._payload = None
        self._taken.set()

    def freeze(self, frozen: bool) -> None:
        """Stop answering and sending, as if the camera's processor hung; or go on."""
        self._frozen.value = int(frozen)

    def drop(self, frames: int) -> None:
        """Lose the next frames on the wire: their ids are used up, nothing of them arrives."""
        self._drops = frames

    def _fill(self, buffer: int, user: Any, exposure_us: int, gain: int, pixel_format: int) -> None:
        """Give Aravis the pixels. Runs in its thread, before it sends the packets."""
        del user, exposure_us, gain, pixel_format
        payload, self._payload = self._payload, None
        lost = payload is None or self._drops > 0
        if payload is not None:
            room = self._aravis.arv_fake_camera_get_payload(self._registers)
            target = self._aravis.arv_buffer_get_data(buffer, ctypes.byref(ctypes.c_size_t()))
            ctypes.memmove(target, payload.ctypes.data, min(room, payload.size))
            self._aravis.arv_buffer_set_timestamp(buffer, self._timestamp_ns)
            self._drops = max(0, self._drops - 1)
            self.dropped += lost
            self.sent += not lost
        ratio = 1.0 if lost else self.packet_loss
        self._gobject.g_object_set(self._camera, b"gvsp-lost-ratio", ctypes.c_double(ratio), None)
        self._taken.set()


def _check_free(address: str) -> None:
    """Aravis does not tell when its port is taken."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind((address, GVCP_PORT))
        except OSError as error:
            where = f"{address} port {GVCP_PORT}"
            raise OSError(f"no camera twin at {where}: {error.strerror}. Is one running already?") from error


def _load_aravis() -> ctypes.CDLL:
    try:
        aravis = ctypes.CDLL("libaravis-0.8.so.0")
    except OSError as error:
        raise native.MissingRequirement(
            "the camera twin needs Aravis 0.8: sudo apt install gir1.2-aravis-0.8"
        ) from error
    pointer, u32, u64 = ctypes.c_void_p, ctypes.c_uint32, ctypes.c_uint64
    text = ctypes.c_char_p
    signatures: dict[str, tuple[Any, list[Any]]] = {
        "arv_gv_fake_camera_new_full": (pointer, [text, text, text]),
        "arv_gv_fake_camera_is_running": (ctypes.c_int, [pointer]),
        "arv_gv_fake_camera_get_fake_camera": (pointer, [pointer]),
        "arv_fake_camera_read_register": (ctypes.c_int, [pointer, u32, pointer]),
        "arv_fake_camera_write_register": (ctypes.c_int, [pointer, u32, u32]),
        "arv_fake_camera_write_memory": (ctypes.c_int, [pointer, u32, u32, text]),
        "arv_fake_camera_set_fill_pattern": (None, [pointer, _FILL, pointer]),
        "arv_fake_camera_set_trigger_frequency": (None, [pointer, ctypes.c_double]),
        "arv_fake_camera_get_payload": (ctypes.c_size_t, [pointer]),
        "arv_buffer_get_data": (pointer, [pointer, pointer]),
        "arv_buffer_set_timestamp": (None, [pointer, u64]),
    }
    for name, (result, arguments) in signatures.items():
        function = getattr(aravis, name)
        function.restype, function.argtypes = result, arguments
    return aravis
