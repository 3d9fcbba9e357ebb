"""The GigE Vision camera's twin, one process: a Mako-like camera whose pixels show what the mirror's true position shows.

    python -m scanhsi_sim.twins.camera --scene testpattern --mirror FILE --trigger-socket PATH

It runs only in a private network namespace (`scanhsi_sim.twins.netns`) and ends when its standard input does. It prints
``ready ADDRESS``, then answers each line on standard input with one line:

``stats``
    One JSON object: exposures, triggers lost, frames sent, exposures during which the mirror moved.
``freeze``, ``thaw``
    Stop answering and sending, and go on.
``drop N``
    Lose the next N frames on the wire.
``loss N``
    From now on lose so many of a million packets, by chance.
``temperature N``
    Be so many thousandths of a degree Celsius warm.
``exit``
    End.
"""

import argparse
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
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scanhsi_sim.scenes import SCENES, Scene, load_scene
from scanhsi_sim.twins import gvcp, netns, registers
from scanhsi_sim.twins.fake import FakeCamera
from scanhsi_sim.twins.mirror import MirrorState
from scanhsi_sim.twins.native import MissingRequirement
from scanhsi_sim.twins.payload import BITS, pack
from scanhsi_sim.twins.sensor import Exposure, Sensor, Source

ADDRESS = "127.0.0.1"
GENICAM = Path(__file__).with_name("mako.xml")
MEMORY_FRAMES = 16
"""Frames the camera can keep that are not yet sent."""

STEPS_PER_TURN = 19_200


@dataclass(slots=True)
class Twin:
    """The running camera: a thread that times exposures, one that renders and sends frames, and Aravis' own.

    Attributes:
        span: Lowest and highest mirror position between two times (`MirrorState.span`).
    """

    camera: FakeCamera
    scene: Scene
    span: Callable[[int, int], tuple[int, int]]
    listener: gvcp.Listener
    pulses: socket.socket | None
    sensor: Sensor = field(init=False)
    smeared: int = 0
    _memory: queue.SimpleQueue[tuple[int, Exposure]] = field(default_factory=queue.SimpleQueue[tuple[int, Exposure]])
    _acquisition: int = 0  # counts them: frames of an earlier one are not sent any more
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def __post_init__(self) -> None:
        self.sensor = Sensor(lambda: self._memory.qsize() < MEMORY_FRAMES)

    def run(self) -> None:
        """Start the threads."""
        for work in (self._time_exposures, self._send_frames):
            threading.Thread(target=work, name=work.__name__, daemon=True).start()

    def _time_exposures(self) -> None:
        sources = [self.listener, *([self.pulses] if self.pulses else [])]
        while True:
            due_ns = self.sensor.wakeup_ns()
            timeout_s = None if due_ns is None else max(0.0, (due_ns - time.monotonic_ns()) * 1e-9)
            ready, _, _ = select.select(sources, [], [], timeout_s)
            self._advance()
            for event in self.listener.receive():  # before the pulses: it may arm the camera for them
                self._advance()
                self._take(event)
            if self.pulses in ready:
                self._advance()
                self._take_pulse()

    def _advance(self) -> None:
        for exposure in self.sensor.advance(time.monotonic_ns()):
            self._memory.put((self._acquisition, exposure))

    def _take_pulse(self) -> None:
        if self.pulses:
            _, _, host_ns = struct.unpack("<qqq", self.pulses.recv(24))
            self.sensor.trigger(Source.LINE1, host_ns)

    def _take(self, event: gvcp.Write | gvcp.Written) -> None:
        if isinstance(event, gvcp.Write):
            if event.address == registers.TRIGGER_SOFTWARE and event.value == 1:
                self.sensor.trigger(Source.SOFTWARE, event.host_ns)
            elif event.address == registers.ACQUISITION and event.value == 0:
                self._stop()
            return
        if event.taken_over:
            self.camera.write(registers.ACQUISITION, 0)  # left on by an application that died
        if self.camera.read(registers.ACQUISITION):
            self.sensor.start(registers.read_settings(self.camera), time.monotonic_ns())
        elif self.sensor.acquiring:
            self._stop()

    def _stop(self) -> None:
        self.sensor.stop()
        with self._lock:
            self._acquisition += 1
            self.camera.withdraw()

    def _send_frames(self) -> None:
        while True:
            acquisition, exposure = self._memory.get()
            if acquisition != self._acquisition:
                continue
            payload = self._render(exposure)
            with self._lock:
                if acquisition != self._acquisition:
                    continue
                self.camera.post(payload, exposure.start_ns + time.time_ns() - time.monotonic_ns())
            self.camera.wait_taken()

    def _render(self, exposure: Exposure) -> NDArray[np.uint8]:
        low, high = self.span(exposure.start_ns, exposure.end_ns)
        self.smeared += high > low
        first = (low + STEPS_PER_TURN // 2) % STEPS_PER_TURN - STEPS_PER_TURN // 2
        settings = exposure.settings
        pixels = self.scene.render(
            first,
            first + high - low,
            exposure_s=settings.exposure_us * 1e-6,
            gain_db=settings.gain_tenths / 10,
            shape=settings.shape,
            offset=settings.offset,
            bits=BITS[settings.pixel_format],
            index=exposure.index,
        )
        return pack(pixels, settings.pixel_format)

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
            case ["loss", count] if count.isdecimal():
                self.camera.packet_loss = int(count) * 1e-6
            case ["temperature", value] if value.removeprefix("-").isdecimal():
                self.camera.write(registers.TEMPERATURE, int(value) & 0xFFFFFFFF)
            case _:
                known = "stats, freeze, thaw, drop N, loss N, temperature N, exit"
                return f"error: unknown command {line!r}; there are: {known}"
        return "ok"

    def stats(self) -> dict[str, int]:
        """Counters since the start: those of `sensor.Counters`, frames sent and dropped, exposures with a moving mirror."""
        frames = {"sent": self.camera.sent, "dropped": self.camera.dropped, "smeared": self.smeared}
        return asdict(self.sensor.counters) | frames


def _standing(step: int) -> Callable[[int, int], tuple[int, int]]:
    return lambda start_ns, end_ns: (step, step)


def build(arguments: argparse.Namespace) -> Twin:
    """Put the twin together; from here on it answers on the network."""
    netns.require_private_network()
    scene = load_scene(arguments.scene, seed=arguments.seed)
    span = MirrorState.open(arguments.mirror).span if arguments.mirror else _standing(arguments.step)
    pulses = None
    if arguments.trigger_socket:
        pulses = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        pulses.bind(arguments.trigger_socket)
    listener = gvcp.Listener()
    camera = FakeCamera(ADDRESS, arguments.serial, arguments.genicam)
    registers.power_on(camera)
    return Twin(camera, scene, span, listener, pulses)


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
    parser.add_argument("--genicam", type=Path, default=GENICAM, help="GenICam description of the camera (XML)")
    parser.add_argument("--mirror", help="file in which the stepper twin keeps the mirror's true position")
    parser.add_argument("--step", type=int, default=0, help="mirror step, where there is no such file")
    parser.add_argument("--trigger-socket", help="unix datagram socket to make, for the stepper twin's trigger pulses")
    return parser


def main() -> int:
    """Run until standard input ends."""
    arguments = parser().parse_args()
    try:
        twin = build(arguments)
    except (MissingRequirement, RuntimeError, OSError) as error:
        sys.stderr.write(f"error: {error}\n")
        return 1
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
