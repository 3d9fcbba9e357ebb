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
import contextlib
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
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from scanhsi_sim.scenes import SCENES, Scene, load_scene
from scanhsi_sim.twins import gvcp, netns, registers
from scanhsi_sim.twins.fake import FakeCamera, MissingRequirement
from scanhsi_sim.twins.mirror import MirrorReading, MirrorState
from scanhsi_sim.twins.payload import BITS, pack
from scanhsi_sim.twins.sensor import Exposed, Sensor, Source

ADDRESS = "127.0.0.1"
GENICAM = Path(__file__).with_name("mako.xml")
MEMORY_FRAMES = 4
"""Frames the camera can keep that are not yet sent."""

_PR_SET_TIMERSLACK = 29


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
            if event.address == registers.TRIGGER_SOFTWARE and event.value == 1:
                self.sensor.trigger(Source.SOFTWARE, event.host_ns, now_ns)
            elif event.address == registers.ACQUISITION and event.value == 0:
                self._stop()
        elif isinstance(event, gvcp.Written):
            if event.taken_over:
                self.camera.write(registers.ACQUISITION, 0)  # left on by an application that died
            if self.camera.read(registers.ACQUISITION):
                self.sensor.start(registers.read_settings(self.camera), now_ns)
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
    with contextlib.suppress(PermissionError):  # only root of the machine may
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(10))


def _survivor(read: Callable[[], MirrorReading]) -> Callable[[], MirrorReading]:
    """Read the mirror; where the stepper twin was killed in the middle of writing, it stays where it was."""
    last = read()

    def look() -> MirrorReading:
        nonlocal last
        with contextlib.suppress(RuntimeError):
            last = read()
        return last

    return look


def build(arguments: argparse.Namespace) -> Twin:
    """Put the twin together; from here on it answers on the network."""
    netns.require_private_network()
    scene = load_scene(arguments.scene, seed=arguments.seed)
    still = MirrorReading(arguments.step, 0, 0, 0, 0, 0)
    look = _survivor(MirrorState.open(arguments.mirror).read) if arguments.mirror else lambda: still
    triggers = None
    if arguments.trigger_socket:
        triggers = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        triggers.bind(arguments.trigger_socket)
    listener = gvcp.Listener()
    camera = FakeCamera(ADDRESS, arguments.serial, GENICAM)
    registers.power_on(camera)
    finished: queue.SimpleQueue[tuple[int, Exposed]] = queue.SimpleQueue()
    sensor = Sensor(look, lambda: finished.qsize() < MEMORY_FRAMES)
    return Twin(camera, scene, sensor, finished, listener, triggers)


def _die(broken: threading.ExceptHookArgs) -> None:
    """A camera with a dead thread is worse than a dead camera."""
    sys.excepthook(broken.exc_type, broken.exc_value or broken.exc_type(), broken.exc_traceback)
    os._exit(70)


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
    threading.excepthook = _die
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
