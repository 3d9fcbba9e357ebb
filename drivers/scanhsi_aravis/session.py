"""One opened camera, blocking: everything that talks to it over the network.

Aravis' camera and device objects belong to one thread, and each call may block for 2.5 s; `AravisCamera` runs every method here on
a thread of its own. Aravis objects are held in attributes only, never in locals that a traceback could keep alive.
"""

from __future__ import annotations

import os
import socket
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal

import structlog

from scanhsi.devices.camera import CameraInfo, CameraSettings, Roi, Trigger
from scanhsi.devices.errors import DeviceError, DeviceLost, DeviceUnavailable, OutOfRange, UnsupportedFeature
from scanhsi.devices.values import Range
from scanhsi_aravis.errors import translated
from scanhsi_aravis.features import EXPOSURE, GAIN, Features
from scanhsi_aravis.lib import Calls, Library, load
from scanhsi_aravis.options import AravisOptions
from scanhsi_aravis.ring import Ring
from scanhsi_aravis.stream import Arrival, Receiver

log: Any = structlog.get_logger(__name__)

_CONTROL_REGISTER = 0x0A00  # GigE Vision bootstrap register CCP; 0 when nobody controls the camera
_RMEM_MAX = Path("/proc/sys/net/core/rmem_max")


class Session:
    """A camera from `open` to `close`; may be opened again.

    Args:
        options: What the instrument file says.
        name: How messages call the camera.
    """

    def __init__(self, options: AravisOptions, name: str) -> None:
        self._options = options
        self._name = name
        self._camera: Any = None
        self._device: Any = None
        self._lost_handler = 0
        self._features = Features(None)
        self._exposure_min_s = 0.0
        self._stream: int | None = None
        self._ring: Ring | None = None
        self._receiver: Receiver | None = None

    def open(self, on_control_lost: Callable[[], object]) -> None:
        """Open the camera, with or without control of it. ``on_control_lost`` is called in Aravis' heartbeat thread."""
        library = load()
        with translated(self._name, "connect"):
            self._camera = library.aravis.Camera.new(self._options.address)
            if not self._camera.is_gv_device():
                raise UnsupportedFeature("it is no GigE Vision camera.", device=self._name, operation="connect")
            self._device = self._camera.get_device()
            self._device.set_range_check_policy(library.aravis.RangeCheckPolicy.ENABLE)  # off, Aravis writes any number
            self._lost_handler = self._device.connect("control-lost", lambda _: on_control_lost())  # pyright: ignore[reportUnknownLambdaType]
            self._features = Features(self._camera)

    def take_control(self) -> bool:
        """Whether the camera is ours, after trying once more to get it. Takes up to 2.5 s when it is not."""
        if not self._device.is_controller():
            with suppress(load().error):
                self._device.take_control()
        return bool(self._device.is_controller())

    def describe(self) -> tuple[CameraInfo, CameraSettings]:
        """Put the camera into a known state (stopped, whole sensor, shortest exposure) and read what it is and allows."""
        with translated(self._name, "connect"):
            self._camera.stop_acquisition()
            features, options = self._features, self._options
            bands, samples, roi_step = features.region_range()
            formats = features.pixel_formats()
            if not formats:
                raise UnsupportedFeature(
                    "it has no pixel format that scanhsi knows.", device=self._name, operation="connect"
                )
            features.untrigger()
            exposure = _narrowed(features.range(EXPOSURE), options.exposure_limits_s, "exposure_limits_s", self._name)
            gain = _narrowed(features.range(GAIN), options.gain_limits_db, "gain_limits_db", self._name)
            self._exposure_min_s = features.range(EXPOSURE).minimum
            settings = CameraSettings(exposure.minimum, gain.minimum, formats[0], Roi(0, 0, samples, bands))
            settings, readout_s = self._apply(settings)
            info = CameraInfo(
                name=self._name,
                vendor=str(self._camera.get_vendor_name()),
                model=str(self._camera.get_model_name()),
                serial=str(self._camera.get_device_serial_number()),
                firmware=features.text("DeviceFirmwareVersion", "DeviceVersion"),
                bands=bands,
                samples=samples,
                pixel_formats=formats,
                exposure=exposure,
                gain=gain,
                roi_step=roi_step,
                triggers=features.triggers(options.trigger_line),
                readout_s=readout_s,
            )
        return info, settings

    def configure(self, settings: CameraSettings) -> tuple[CameraSettings, float]:
        """Write checked settings; return them as applied, and the read-out time in s."""
        with translated(self._name, "configure"):
            return self._apply(settings)

    def set_frame_period(self, period_s: float) -> float:
        """Set the time between exposures of the camera's own clock, s; return it as applied."""
        with translated(self._name, "set frame period"):
            return self._features.set_frame_period(period_s)

    def temperature_c(self) -> float | None:
        """How warm the camera is; None where it does not tell, or refuses to. Only reads, so it may come while armed.

        Raises:
            DeviceLost: No answer for 2.5 s.
        """
        try:
            with translated(self._name, "temperature"):
                return self._features.temperature_c()
        except DeviceLost:
            raise
        except DeviceError as error:  # nothing that a scan should fail of
            log.warning("the camera's temperature cannot be read", device=self._name, reason=error.message)
            return None

    def start(self, trigger: Trigger, buffers: int, deliver: Callable[[Arrival], object]) -> Ring:
        """Make the stream and its ring, and start acquisition."""
        self.stop(lost=False)
        with translated(self._name, "arm"):
            if trigger is Trigger.FREE_RUN:
                self._features.untrigger()
            else:
                self._features.trigger("Software" if trigger is Trigger.SOFTWARE else self._options.trigger_line)
            self._make_stream(load(), buffers, deliver)
            self._camera.start_acquisition()
        assert self._ring is not None
        return self._ring

    def fire(
        self, sent: Callable[[int], object], confirmed: Callable[[int], object], refused: Callable[[], object]
    ) -> None:
        """Send a software trigger. The three are told when, ns, from this thread; `refused` only if `confirmed` is not."""
        sent(time.monotonic_ns())
        try:
            with translated(self._name, "expose"):
                self._camera.software_trigger()
        except DeviceError:
            refused()
            raise
        confirmed(time.monotonic_ns())

    def check(self) -> bool:
        """Ask the camera whether it is there; whether anybody still controls it.

        Raises:
            DeviceLost: No answer for 2.5 s.
        """
        with translated(self._name, "frames"):
            return bool(self._device.read_register(_CONTROL_REGISTER))

    def stop(self, *, lost: bool) -> None:
        """Stop acquisition and free the stream; leased frames stay readable. Idempotent. Says nothing to a lost camera."""
        try:
            if self._receiver is not None and not lost:
                with translated(self._name, "disarm"):
                    self._camera.stop_acquisition()
        except DeviceLost:
            lost = True
            raise
        finally:
            self._end_reception()
            if self._stream is not None and not lost:
                load().calls.release(self._stream)
                self._stream = None

    def close(self, *, lost: bool) -> None:
        """Free everything and give up control. Idempotent; never raises for a camera that is gone.

        Aravis says goodbye to each camera, which takes 10 s with one that does not answer or listens to another program. That
        goes on in a daemon thread, without anything of ours.
        """
        try:
            self.stop(lost=lost)
        except DeviceError as error:
            lost = isinstance(error, DeviceLost)
        if self._device is None:
            self._camera = None
            return
        self._device.handler_disconnect(self._lost_handler)
        calls = load().calls
        lost = lost or not self._device.is_controller()
        if not lost:
            with suppress(load().error):
                self._device.leave_control()
        leftovers = [pointer for pointer in (self._stream, calls.ref(hash(self._device))) if pointer is not None]
        self._features.forget()
        self._device = self._camera = self._stream = None
        if lost:
            threading.Thread(target=_release, args=(calls, leftovers), name="lost-camera", daemon=True).start()
        else:
            _release(calls, leftovers)

    def _end_reception(self) -> None:
        receiver, ring = self._receiver, self._ring
        self._receiver = self._ring = None
        if receiver is not None:
            receiver.stop()
        if ring is not None:
            ring.close()

    def _apply(self, settings: CameraSettings) -> tuple[CameraSettings, float]:
        applied, readout_s = self._features.apply(settings, self._exposure_min_s)
        options = self._options
        self._features.set_packet_size(options.packet_size, self._address())
        if options.stream_bytes_per_second is not None:
            self._features.set_bandwidth(options.stream_bytes_per_second)
        return applied, options.readout_s or readout_s

    def _address(self) -> str:
        return str(self._device.get_device_address().get_address().to_string())

    def _make_stream(self, library: Library, buffers: int, deliver: Callable[[Arrival], object]) -> None:
        aravis, calls = library.aravis, library.calls
        mode = receive_mode(self._options, self._name)
        options = aravis.GvStreamOption
        self._camera.gv_set_stream_options(options.PACKET_SOCKET_DISABLED if mode == "socket" else options.NONE)
        wrapper = self._camera.create_stream(None, None)
        wrapper.set_property(
            "packet-resend", aravis.GvStreamPacketResend.NEVER
        )  # else a lost packet delays good frames
        wrapper.set_property("socket-buffer", aravis.GvStreamSocketBuffer.FIXED)  # AUTO is too small for a small ROI
        wrapper.set_property("socket-buffer-size", self._options.socket_buffer)
        self._stream = calls.ref(hash(wrapper))
        del wrapper  # what is left is one reference, ours: the stream ends when we say so
        self._ring = Ring(calls, self._stream, int(self._camera.get_payload()), buffers)
        self._receiver = Receiver(calls, self._stream, self._ring, deliver)
        if self._options.realtime_priority is not None:
            _raise_priority(self._options.realtime_priority, self._name)


def _release(calls: Calls, pointers: list[int]) -> None:
    for pointer in pointers:
        calls.release(pointer)


def receive_mode(options: AravisOptions, name: str) -> Literal["packet-socket", "socket"]:
    """Choose how frames are received, and warn of a kernel that will cut the socket's buffer.

    Raises:
        DeviceUnavailable: A packet socket is demanded and not permitted.
    """
    if options.receive != "socket" and _packet_socket_permitted():
        return "packet-socket"
    if options.receive == "packet-socket":
        raise DeviceUnavailable(
            "a packet socket is not permitted.",
            device=name,
            operation="arm",
            hint='`sudo setcap cap_net_raw+ep` on the real interpreter binary, or receive = "socket".',
        )
    with suppress(OSError, ValueError):
        allowed = int(_RMEM_MAX.read_text())
        if allowed < options.socket_buffer:
            log.warning(
                "socket buffer is cut by the kernel, frames may be lost",
                device=name,
                asked=options.socket_buffer,
                granted=allowed,
                hint=f"sudo sysctl -w net.core.rmem_max={options.socket_buffer}",
            )
    return "socket"


def _packet_socket_permitted() -> bool:
    try:
        socket.socket(socket.AF_PACKET, socket.SOCK_RAW).close()
    except OSError:
        return False
    return True


def _raise_priority(priority: int, name: str) -> None:
    """Give Aravis' receive threads of this process a realtime priority; warn where that is not permitted."""
    for comm in Path("/proc/self/task").glob("*/comm"):
        try:
            if comm.read_text().strip() == "arv_gv_stream":
                os.sched_setscheduler(int(comm.parent.name), os.SCHED_FIFO, os.sched_param(priority))
        except PermissionError as error:
            log.warning("no realtime priority for the receive thread", device=name, reason=str(error))
        except OSError:
            continue  # a thread that has just ended


def _narrowed(allowed: Range, limits: tuple[float, float] | None, option: str, name: str) -> Range:
    if limits is None:
        return allowed
    low, high = max(allowed.minimum, limits[0]), min(allowed.maximum, limits[1])
    if low > high:
        raise OutOfRange(f"option {option} leaves nothing of what the camera allows, {allowed}.", device=name)
    return Range(low, high, allowed.step, allowed.unit)
