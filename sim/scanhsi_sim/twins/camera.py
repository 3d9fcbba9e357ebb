"""The GigE Vision camera's twin, one process: a Mako-like camera whose pixels show what the mirror's true position shows.

    python -m scanhsi_sim.twins.camera --scene testpattern --mirror FILE --trigger-socket PATH

It runs only in a private network namespace (`scanhsi_sim.twins.netns`) and ends when its standard input does. It prints
``ready ADDRESS``, then answers each line on standard input with one line:

``stats``
    One JSON object: exposures, triggers lost, frames sent, lateness.
``freeze``, ``thaw``
    Stop answering and sending, and go on.
``drop N``
    Lose the next N frames on the wire.
``exit``
    End.
"""

import argparse
import ctypes
import gc
import json
import os
import queue
import select
import socket
import struct
import sys
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path

from scanhsi_sim.scenes import SCENES, Scene, load_scene
from scanhsi_sim.twins import gvcp, netns
from scanhsi_sim.twins.fake import FakeCamera, MissingRequirement
from scanhsi_sim.twins.mirror import MirrorReading, MirrorState
from scanhsi_sim.twins.payload import BITS, MONO12_PACKED, pack
from scanhsi_sim.twins.sensor import Exposed, Sensor, Settings, Source

ADDRESS = "127.0.0.1"
GENICAM = Path(__file__).with_name("mako.xml")
MEMORY_FRAMES = 4
"""Frames the camera can keep that are not yet sent."""

_WIDTH, _HEIGHT, _OFFSET_X, _OFFSET_Y, _FORMAT = 0x100, 0x104, 0x130, 0x134, 0x128
_SENSOR_HEIGHT, _SENSOR_WIDTH = 0x118, 0x11C
_GAIN, _EXPOSURE, _ACQUISITION = 0x110, 0x120, 0x124
_TEMPERATURE, _PERIOD, _TRIGGER_MODE, _TRIGGER_SOURCE, _TRIGGER_SOFTWARE, _RATE = (
    0x500,
    0x504,
    0x50C,
    0x510,
    0x518,
    0x51C,
)
_VENDOR, _MODEL, _VERSION = 0x48, 0x68, 0x88
_SENSOR_BANDS, _SENSOR_SAMPLES = 1088, 2048
_PR_SET_TIMERSLACK = 29


def power_on(camera: FakeCamera) -> None:
    """Give the registers the values that a camera has after power-on."""
    camera.write_text(_VENDOR, "Allied Vision Technologies")
    camera.write_text(_MODEL, "Mako G-223B (twin)")
    camera.write_text(_VERSION, "1.0.0")
    for address, value in {
        _SENSOR_WIDTH: _SENSOR_SAMPLES,
        _SENSOR_HEIGHT: _SENSOR_BANDS,
        _WIDTH: _SENSOR_SAMPLES,
        _HEIGHT: _SENSOR_BANDS,
        _FORMAT: MONO12_PACKED,
        _EXPOSURE: 10_000,
        _PERIOD: 50_000,
        _TEMPERATURE: 43_000,
        _RATE: 115_000_000,
    }.items():
        camera.write(address, value)


def read_settings(camera: FakeCamera) -> Settings:
    """What the registers say now."""
    triggered = camera.read(_TRIGGER_MODE) == 1
    return Settings(
        source=Source(camera.read(_TRIGGER_SOURCE)) if triggered else Source.FIXED_RATE,
        exposure_us=camera.read(_EXPOSURE),
        period_us=camera.read(_PERIOD),
        gain_tenths=camera.read(_GAIN),
        pixel_format=camera.read(_FORMAT),
        shape=(camera.read(_HEIGHT), camera.read(_WIDTH)),
        offset=(camera.read(_OFFSET_Y), camera.read(_OFFSET_X)),
    )


@dataclass(slots=True)
class Twin:
    """The running camera: a thread for the sensor's timing, one that renders and sends, and Aravis' own."""

    camera: FakeCamera
    scene: Scene
    sensor: Sensor
    finished: queue.SimpleQueue[tuple[int, Exposed]]
    listener: gvcp.Listener
    triggers: socket.socket | None
    _acquisition: int = 0  # counts them: frames of an earlier one are not sent any more
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def run(self) -> None:
        """Start the threads."""
        for work in (self._time_exposures, self._send_frames):
            threading.Thread(target=work, name=work.__name__, daemon=True).start()

    def _time_exposures(self) -> None:
        _hurry()
        sources = [self.listener, *([self.triggers] if self.triggers else [])]
        while True:
            due_ns = self.sensor.wakeup_ns()
            timeout_s = None if due_ns is None else max(0.0, (due_ns - time.monotonic_ns()) * 1e-9)
            ready, _, _ = select.select(sources, [], [], timeout_s)
            now_ns = time.monotonic_ns()
            for exposed in self.sensor.advance(now_ns):
                self.finished.put((self._acquisition, exposed))
            if self.triggers in ready:
                self._take_pulse(now_ns)
            if self.listener in ready:
                self._take_packet(now_ns)

    def _take_pulse(self, now_ns: int) -> None:
        if self.triggers:
            _, position, host_ns = struct.unpack("<qqq", self.triggers.recv(24))
            self.sensor.trigger(Source.LINE1, host_ns, now_ns, position)

    def _take_packet(self, now_ns: int) -> None:
        event = self.listener.receive()
        if isinstance(event, gvcp.Write):
            if event.address == _TRIGGER_SOFTWARE and event.value == 1:
                self.sensor.trigger(Source.SOFTWARE, event.host_ns, now_ns)
            elif event.address == _ACQUISITION and event.value == 0:
                self._stop()
        elif isinstance(event, gvcp.Written):
            if event.taken_over:
                self.camera.write(_ACQUISITION, 0)  # left on by an application that died
            if self.camera.read(_ACQUISITION):
                self.sensor.start(read_settings(self.camera), now_ns)
            elif self.sensor.acquiring:
                self._stop()

    def _stop(self) -> None:
        self.sensor.stop()
        with self._lock:
            self._acquisition += 1
            self.camera.withdraw()

    def _send_frames(self) -> None:
        while True:
            acquisition, exposed = self.finished.get()
            if acquisition != self._acquisition:
                continue
            settings = exposed.settings
            pixels = self.scene.render(
                exposed.step_low,
                exposed.step_high,
                exposure_s=settings.exposure_us * 1e-6,
                gain_db=settings.gain_tenths / 10,
                shape=settings.shape,
                offset=settings.offset,
                bits=BITS[settings.pixel_format],
                index=exposed.index,
            )
            payload = pack(pixels, settings.pixel_format)
            with self._lock:
                if acquisition != self._acquisition:
                    continue
                self.camera.post(payload, exposed.start_ns + time.time_ns() - time.monotonic_ns())
            self.camera.wait_taken()

    def answer(self, line: str) -> str:
        """Do what one line of standard input asks for."""
        match line.split():
            case ["stats"]:
                return json.dumps(self.stats())
            case ["freeze"]:
                self.camera.freeze(True)
            case ["thaw"]:
                self.camera.freeze(False)
            case ["drop", count] if count.isdecimal():
                self.camera.drop(int(count))
            case _:
                return f"error: unknown command {line!r}; there are: stats, freeze, thaw, drop N, exit"
        return "ok"

    def stats(self) -> dict[str, int | list[int]]:
        """Counters; lateness in us as [p50, p99, max] over all exposures."""
        counters = self.sensor.counters
        starts, ends = zip(*counters.lateness_ns, strict=True) if counters.lateness_ns else ((0,), (0,))
        return {
            "exposures": counters.exposures,
            "sent": self.camera.sent,
            "dropped": self.camera.dropped,
            "busy": counters.busy,
            "unread": counters.unread,
            "ignored": counters.ignored,
            "smeared": counters.smeared,
            "start_late_us": _percentiles(starts),
            "end_late_us": _percentiles(ends),
        }


def _percentiles(values_ns: tuple[int, ...]) -> list[int]:
    ordered = sorted(values_ns)
    return [ordered[min(len(ordered) - 1, int(len(ordered) * part))] // 1000 for part in (0.5, 0.99, 1.0)]


def _hurry() -> None:
    """Wake the calling thread as promptly as this machine allows: it notes where the mirror is when an exposure begins."""
    ctypes.CDLL(None).prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(10))
    except PermissionError:
        pass  # only root of the machine may; the default scheduler wakes it well enough on a machine with an idle core


def build(arguments: argparse.Namespace) -> Twin:
    """Put the twin together; from here on it answers on the network."""
    netns.require_private_network()
    scene = load_scene(arguments.scene, seed=arguments.seed)
    if arguments.mirror:
        look = MirrorState.open(arguments.mirror).read
    else:
        still = MirrorReading(arguments.step, 0, 0, 0, 0, 0)
        look = lambda: still  # noqa: E731
    triggers = None
    if arguments.trigger_socket:
        triggers = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        triggers.bind(arguments.trigger_socket)
    listener = gvcp.Listener()
    camera = FakeCamera(ADDRESS, arguments.serial, GENICAM)
    power_on(camera)
    finished: queue.SimpleQueue[tuple[int, Exposed]] = queue.SimpleQueue()
    sensor = Sensor(look, lambda: finished.qsize() < MEMORY_FRAMES)
    return Twin(camera, scene, sensor, finished, listener, triggers)


def parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m scanhsi_sim.twins.camera", description="GigE Vision camera twin")
    parser.add_argument("--scene", default="testpattern", choices=sorted(SCENES))
    parser.add_argument("--seed", type=int, default=0, help="of the scene and the sensor's noise")
    parser.add_argument("--serial", default="50-0503419007")
    parser.add_argument("--mirror", help="file in which the stepper twin keeps the mirror's true position")
    parser.add_argument("--step", type=int, default=0, help="mirror step, where there is no such file")
    parser.add_argument("--trigger-socket", help="unix datagram socket to make, for the stepper twin's trigger pulses")
    return parser


def main() -> int:
    """Run until standard input ends."""
    arguments = parser().parse_args()
    sys.setswitchinterval(0.0002)  # the timing thread must not wait 5 ms for the one that renders
    try:
        twin = build(arguments)
    except (MissingRequirement, RuntimeError, OSError) as error:
        sys.stderr.write(f"error: {error}\n")
        return 1
    gc.freeze()
    twin.run()
    sys.stdout.write(f"ready {ADDRESS}\n")
    sys.stdout.flush()
    for line in sys.stdin:
        if line.strip() == "exit":
            break
        sys.stdout.write(twin.answer(line.strip()) + "\n")
        sys.stdout.flush()
    if arguments.trigger_socket:
        Path(arguments.trigger_socket).unlink(missing_ok=True)
    sys.stdout.flush()
    os._exit(0)  # Aravis' thread cannot be joined while it is frozen, and nothing is left to be saved


if __name__ == "__main__":
    sys.exit(main())
