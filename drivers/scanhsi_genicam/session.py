"""One connection to a camera: blocking calls for one control thread, and the thread that takes frames from the stream."""

from __future__ import annotations

import threading
import time
import weakref
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import structlog
from numpy.typing import NDArray

from scanhsi.devices.camera import CameraInfo, CameraSettings
from scanhsi.devices.errors import DeviceError, DeviceLost, DeviceNotFound, DeviceTimeout
from scanhsi_genicam import features
from scanhsi_genicam.errors import classify, make, translated
from scanhsi_genicam.options import GenicamOptions

if TYPE_CHECKING:
    from viva_genicam import Camera, Frame, FrameStream, GigeDeviceInfo

log: Any = structlog.get_logger(__name__)

_WAIT_MS = 50  # the longest that stopping takes


@dataclass(frozen=True, slots=True)
class Arrival:
    """What the stream gave; ``payload`` is None where the frame is not whole, and then ``problem`` says why."""

    received_ns: int
    payload: NDArray[np.uint8] | None
    problem: str = ""
    frame_id: int = 0
    device_ns: int | None = None


class Leases:
    """Counts the frames that consumers look at: no more than the buffers that were asked for."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._out = 0
        self._lock = threading.RLock()  # re-entrant: the garbage collector may end a lease while this thread holds it

    def lease(self, payload: bytes) -> NDArray[np.uint8] | None:
        """A read-only array of the bytes, or None when all buffers are out."""
        with self._lock:
            if self._out >= self._count:
                return None
            self._out += 1
        array = np.frombuffer(payload, np.uint8)
        weakref.finalize(array, self._give_back).atexit = False
        return array

    def _give_back(self) -> None:
        with self._lock:
            self._out -= 1


class Session:
    """The camera; every method blocks and runs in one and the same thread."""

    def __init__(self, options: GenicamOptions, name: str) -> None:
        self._options = options
        self._name = name
        self._camera: Camera | None = None
        self._stream: FrameStream | None = None
        self._pump: Pump | None = None

    def open(self) -> CameraInfo:
        """Find the camera and take control of it."""
        with translated(self._name, "connect"):
            from viva_genicam import connect_gige

            self._camera = connect_gige(self._find(), self._options.interface)
            return features.describe(self._camera, self._options, self._name)

    def _find(self) -> GigeDeviceInfo:
        from viva_genicam import discover

        options = self._options
        wanted = options.address.lower()
        for found in discover(round(options.discovery_s * 1000), options.interface, all=wanted.startswith("127.")):
            if wanted in (found.ip, found.mac.lower()):
                return found
        raise make(DeviceNotFound, "no camera of that address answers.", self._name, "connect")

    def configure(self, settings: CameraSettings, info: CameraInfo) -> CameraSettings:
        """See `features.apply`."""
        with translated(self._name, "configure"):
            return features.apply(self._open(), settings, info)

    def temperature_c(self) -> float | None:
        """How warm the camera is; None where it does not tell, or refuses to. Only reads, so it may come while armed.

        Raises:
            DeviceLost, DeviceTimeout: No answer.
        """
        camera = self._open()
        try:
            with translated(self._name, "temperature"):
                return features.temperature_c(camera)
        except (DeviceLost, DeviceTimeout):
            raise
        except DeviceError as error:  # nothing that a scan should fail of
            log.warning("the camera's temperature cannot be read", device=self._name, reason=error.message)
            return None

    def start(self, buffers: int, deliver: Callable[[Arrival | DeviceError], object]) -> None:
        """Wait for software triggers, start the stream."""
        self.stop()  # of an earlier acquisition, where disarming was cancelled
        with translated(self._name, "arm"):
            camera = self._open()
            camera.enable_trigger("FrameStart", "Software")
            self._stream = camera.stream(
                iface=self._options.interface, packet_size=self._options.packet_size, deliver_incomplete=True
            )
            self._stream.__enter__()
            self._pump = Pump(self._stream, Leases(buffers), deliver, self._name, features.tick_ns(camera))

    def fire(self, sent: Callable[[int], object], confirmed: Callable[[int], object]) -> None:
        """Trigger; tell when the trigger was sent, and when the camera had confirmed it, CLOCK_MONOTONIC in ns."""
        with translated(self._name, "expose"):
            camera = self._open()
            sent(time.monotonic_ns())
            camera.trigger_software()
            confirmed(time.monotonic_ns())

    def check(self) -> None:
        """Raise `DeviceLost` where control of the camera is lost."""
        with translated(self._name, "heartbeat"):
            if self._open().control_state.value == "Lost":
                raise make(DeviceLost, "control of it was lost.", self._name, "heartbeat")

    def stop(self) -> None:
        """Take what has come, stop the stream."""
        if self._pump is not None:
            self._pump.stop()
        stream, self._stream, self._pump = self._stream, None, None
        if stream is not None:
            with translated(self._name, "disarm"):
                stream.__exit__(None, None, None)

    def close(self) -> None:
        """Give up control; stop the stream, where a disarming that was cancelled did not."""
        with suppress(DeviceError):
            self.stop()
        camera, self._camera = self._camera, None
        if camera is not None:
            with suppress(DeviceError), translated(self._name, "close"):
                camera.close()

    def _open(self) -> Camera:
        if self._camera is None:
            raise DeviceError("not connected.", device=self._name)
        return self._camera


class Pump:
    """The thread that takes frames; runs from construction to `stop`."""

    def __init__(
        self,
        stream: FrameStream,
        leases: Leases,
        deliver: Callable[[Arrival | DeviceError], object],
        name: str,
        tick_ns: float,
    ) -> None:
        self._stream, self._leases, self._deliver, self._name, self._tick_ns = stream, leases, deliver, name, tick_ns
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="genicam-frames", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Deliver what has been received and join the thread."""
        self._stopping.set()
        self._thread.join()

    def _run(self) -> None:
        try:
            while self._take():
                pass
        except RuntimeError:
            return  # the event loop is closed: nobody is left to tell

    def _take(self) -> bool:
        """Wait for one frame; False when there are no more."""
        from viva_genicam import GenicamError

        stopping = self._stopping.is_set()
        try:
            frame = self._stream.next_frame(1 if stopping else _WAIT_MS)
        except GenicamError as error:
            if "timeout" in str(error):
                return not stopping
            self._deliver(make(classify(str(error)), f"viva-genicam says: {error}.", self._name, "frames"))
            return False
        if frame is not None:
            self._deliver(self._arrival(frame, time.monotonic_ns()))
        return frame is not None

    def _arrival(self, frame: Frame, now_ns: int) -> Arrival:
        if not frame.is_complete:
            missing = frame.missing_packets
            return Arrival(
                now_ns, None, f"{missing} packets missing" if missing else f"it ended as {frame.status.value}"
            )
        payload = self._leases.lease(_without_padding(frame))
        if payload is None:
            return Arrival(now_ns, None, "no free buffer: every one is in use")
        device_ns = None if frame.ts_dev is None else round(frame.ts_dev * self._tick_ns)
        return Arrival(now_ns, payload, "", frame.block_id, device_ns)


def _without_padding(frame: Frame) -> bytes:
    payload = frame.payload()
    if not frame.padding_x:
        return payload
    lines = np.frombuffer(payload, np.uint8).reshape(frame.height, -1)
    return lines[:, : -frame.padding_x].tobytes()
