"""A small bench for engine tests: devices with constant delays that obey the contracts and write down what really happened.

Independent of the simulator that ships, so that engine and simulator do not vouch for each other. The mirror's true motion and the
true exposures are kept as intervals; faults are scripted by operation number or by line.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from scanhsi.clock import now_ns, sleep_until_ns
from scanhsi.cube.records import LineRecords, LineStatus
from scanhsi.devices import (
    ActuatorInfo,
    CameraInfo,
    CameraSettings,
    Exposure,
    Frame,
    FrameChannel,
    FrameGap,
    Motion,
    PixelFormat,
    Pixels,
    Range,
    Sighting,
    Sweep,
    Trigger,
    check_settings,
)
from scanhsi.devices.errors import DeviceLost, PositionLost

SHAPE = (4, 6)


@dataclass
class Bench:
    """What is true on the bench, whatever the engine believes."""

    exposure_ms: float = 20.0
    transfer_ms: float = 5.0
    readout_ms: float = 8.0
    copy_ms: float = 0.0
    move_ms: float = 3.0
    latency_ms: tuple[float, ...] = (0.0,)  # of each move, over and over: part of it in which the mirror still stands
    fail_at: int | None = None  # number of the device operation that raises DeviceLost
    lose: frozenset[int] = frozenset()  # exposures whose frame is reported as a gap
    swallow: frozenset[int] = frozenset()  # exposures whose frame never comes, without a word
    ignore: frozenset[int] = frozenset()  # pulses that the camera does not see
    stalls: dict[int, float] = field(default_factory=dict)  # pulse -> ms by which the mirror falls behind there
    least_latency_ms: float = 0.0
    moves: int = 0
    moving: bool = False  # a call of move_to is under way
    operations: int = 0
    position: int = 7
    homed: bool = True
    stopped: bool = True
    armed: bool = False
    motions: list[tuple[int, int]] = field(default_factory=list)
    exposures: list[tuple[int, int]] = field(default_factory=list)
    on_pulse: Callable[[int], None] | None = None

    def operation(self) -> None:
        """Count one device operation; fail if it is the one that shall."""
        number, self.operations = self.operations, self.operations + 1
        if number == self.fail_at:
            raise DeviceLost("the bench pulled the plug.", device="bench", operation=f"operation {number}")

    def moved_while_exposing(self) -> list[tuple[int, int]]:
        """Exposures during which the mirror moved."""
        return [
            (start, end)
            for start, end in self.exposures
            if any(begin < end and start < finish for begin, finish in self.motions)
        ]


def _ns(ms: float) -> int:
    return round(ms * 1e6)


class BenchCamera:
    """A camera with constant delays; frames carry the true mirror position in every pixel."""

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self.info = CameraInfo(
            name="camera bench",
            vendor="scanhsi tests",
            model="bench",
            serial="1",
            firmware="1",
            bands=SHAPE[0],
            samples=SHAPE[1],
            pixel_formats=(PixelFormat.MONO8, PixelFormat.MONO12),
            exposure=Range(0.0, 2.0, unit="s"),
            gain=Range(0, 24, unit="dB"),
            triggers=frozenset(Trigger),
            readout_s=bench.readout_ms * 1e-3,
            simulated=True,
        )
        self._channel = FrameChannel()
        self._index = 0
        self._link_free_ns = 0
        self._tasks: set[asyncio.Task[None]] = set()
        self._settings = CameraSettings(0.01)

    async def connect(self) -> None:
        self.bench.operation()

    async def close(self) -> None:
        await self.disarm()

    async def configure(self, settings: CameraSettings) -> CameraSettings:
        self.bench.operation()
        await asyncio.sleep(0.001)
        self._settings = check_settings(self.info, settings)
        return self._settings

    async def arm(self, trigger: Trigger, buffers: int) -> None:
        self.bench.operation()
        await asyncio.sleep(0.001)
        self.bench.armed = True
        self._channel = FrameChannel()
        self._index = 0
        self.bench.on_pulse = self._pulse if trigger is Trigger.LINE else None
        if trigger is Trigger.FREE_RUN:
            self._spawn(self._run_free())

    async def expose(self) -> Exposure:
        return await self.expose_foretold(lambda _: None)

    async def expose_foretold(self, foretold: Callable[[int], None]) -> Exposure:
        self.bench.operation()
        start = now_ns()
        end = start + _ns(self.bench.exposure_ms)
        foretold(end)
        index = self._begin(start, end)
        if self.bench.exposure_ms:
            await sleep_until_ns(end)
        self.bench.operation()
        return Exposure(index=index, trigger_ns=start, start_ns=start, end_ns=end, timed=False)

    def frames(self) -> FrameChannel:
        return self._channel

    async def unpack(self, frame: Frame, out: Pixels | None) -> None:
        self.bench.operation()
        if self.bench.copy_ms:
            await asyncio.sleep(self.bench.copy_ms * 1e-3)
        if out is not None and frame.payload is not None:
            np.copyto(out.reshape(-1), frame.payload.view(out.dtype))

    async def disarm(self) -> None:
        self.bench.armed = False
        now = now_ns()  # an exposure under way ends here
        self.bench.exposures = [(start, min(end, now)) for start, end in self.bench.exposures if start < now]
        self.bench.on_pulse = None
        for task in self._tasks:
            task.cancel()
        self._channel.close()
        await asyncio.sleep(0)

    def shortest_trigger_period_s(self) -> float:
        return max(self._settings.exposure_s, self.info.readout_s)

    async def set_frame_period(self, period_s: float) -> float:
        self._period_s = period_s
        return period_s

    def dead_time_s(self) -> float:
        return 0.0

    def _begin(self, start: int, end: int) -> int:
        index, self._index = self._index, self._index + 1
        self.bench.exposures.append((start, end))
        self._link_free_ns = max(end, self._link_free_ns) + _ns(self.bench.transfer_ms)
        if self.bench.transfer_ms:
            self._spawn(self._deliver(index, start, self._link_free_ns, self.bench.position))
        else:
            self._put(index, start, now_ns(), self.bench.position)
        return index

    async def _deliver(self, index: int, start: int, when: int, position: int) -> None:
        await sleep_until_ns(when)
        self._put(index, start, when, position)

    def _put(self, index: int, start: int, when: int, position: int) -> None:
        if index in self.bench.swallow:
            return
        if index in self.bench.lose:
            self._channel.put(FrameGap(index, 1, "the bench lost it"))
            return
        dtype = np.dtype(self._settings.pixel_format.dtype)
        payload = np.full(SHAPE, position % 256, dtype).reshape(-1).view(np.uint8)
        self._channel.put(
            Frame(
                index=index,
                frame_id=index + 65400,
                payload=payload,
                pixel_format=self._settings.pixel_format,
                shape=SHAPE,
                received_ns=when,
                device_ns=start + 123,
                first_byte_ns=when - _ns(self.bench.transfer_ms),
                exposure_start_ns=start,
            )
        )

    def _pulse(self, number: int) -> None:
        if number in self.bench.ignore:
            return
        start = now_ns()
        self._begin(start, start + _ns(self.bench.exposure_ms))

    async def _run_free(self) -> None:
        start = now_ns()
        while True:
            self._begin(start, start + _ns(self.bench.exposure_ms))
            start += round(self._period_s * 1e9)
            await sleep_until_ns(start)

    def _spawn(self, work) -> None:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)


class BenchActuator:
    """An actuator with a constant move time, of which the first part may be latency; says where it is and when it moved."""

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self.info = ActuatorInfo(
            name="actuator bench",
            model="bench",
            firmware="1",
            steps_per_revolution=19200,
            limits=Range(-5000, 5000, 1, "steps"),
            max_rate_steps_s=4000.0,
            simulated=True,
        )

    @property
    def position(self) -> int:
        return self.bench.position

    @property
    def homed(self) -> bool:
        return self.bench.homed

    async def connect(self) -> None:
        self.bench.operation()

    async def close(self) -> None:
        await self.stop()

    async def home(self) -> Motion:
        self.bench.operation()
        start = now_ns()
        await asyncio.sleep(1.0)
        self.bench.position, self.bench.homed = 0, True
        return Motion(0, start, now_ns())

    async def move_to(self, step: int) -> Motion:
        self.bench.operation()
        if not self.bench.homed:
            raise PositionLost("not homed")
        self.bench.stopped = False
        start = now_ns()
        end = start + _ns(self.bench.move_ms)
        latency = self.bench.latency_ms[self.bench.moves % len(self.bench.latency_ms)]
        self.bench.moves += 1
        began = min(start + _ns(latency), end)
        if self.bench.move_ms:
            self.bench.motions.append((began, end))
            self.bench.moving = True
            try:
                await sleep_until_ns(end)
            finally:
                self.bench.moving = False
        self.bench.operation()
        self.bench.position = step
        return Motion(step, start, end, started_ns=began)

    def least_latency_s(self, step: int) -> float:
        return self.bench.least_latency_ms * 1e-3

    async def stop(self) -> None:
        await asyncio.sleep(0.0005)
        self.bench.stopped = True

    def check_sweep(self, sweep: Sweep) -> Sweep:
        self.info.limits.check("last step of the sweep", sweep.last)
        return sweep

    def extent(self, sweep: Sweep) -> tuple[int, int]:
        ends = _before(sweep), sweep.last + sweep.every
        return min(ends), max(ends)

    def run_up_s(self, sweep: Sweep) -> float:
        return 0.010

    async def prepare_sweep(self, sweep: Sweep) -> Motion:
        return await self.move_to(_before(sweep))

    async def sweep(self, sweep: Sweep) -> Motion:
        self.bench.operation()
        self.bench.stopped = False
        passing = now_ns() + 10_000_000
        period = abs(sweep.every) / sweep.rate_steps_s * 1e9
        for number in range(sweep.count):
            if number in self.bench.stalls:
                passing += _ns(self.bench.stalls[number])
            for part in range(abs(sweep.every)):
                await sleep_until_ns(passing + round((number + part / abs(sweep.every)) * period))
                self.bench.position = sweep.first + number * sweep.every + (part if sweep.every > 0 else -part)
                if part == 0 and sweep.pulses and self.bench.on_pulse is not None:
                    self.bench.on_pulse(number)
        await asyncio.sleep(period * 1e-9)
        self.bench.position = sweep.last + sweep.every
        await asyncio.sleep(0.010)
        return Motion(self.bench.position, passing, now_ns(), sweep.count if sweep.pulses else 0)

    async def locate(self) -> Sighting:
        asked = now_ns()
        await asyncio.sleep(0.002)
        return Sighting(self.bench.position, (asked + now_ns()) // 2, (now_ns() - asked) // 2)


def _before(sweep: Sweep) -> int:
    return sweep.first - (40 if sweep.every > 0 else -40)


class MemorySink:
    """Keeps lines in memory and watches the contract: order, window, no line twice."""

    def __init__(
        self, *, capacity: int = 8, batch: int = 1, store_ms: float = 0.0, fail_at_line: int | None = None
    ) -> None:
        self._capacity, self._batch, self._store_ms, self._fail_at_line = capacity, batch, store_ms, fail_at_line
        self.records = LineRecords(0)
        self.pixels: dict[int, Pixels] = {}
        self.opened = self.closed = False
        self.most_in_memory = 0
        self._begun = self._safe = self._appended = 0

    @property
    def capacity(self) -> int:
        return self._capacity

    @property
    def output(self) -> str | None:
        return "memory"

    async def open(self, records: LineRecords) -> None:
        await asyncio.sleep(0)
        self.records, self.opened = records, True

    def buffer(self, line: int) -> Pixels | None:
        assert line < self._safe + self._capacity, f"line {line} outside the window of credits"
        self._begun = line + 1
        self.most_in_memory = max(self.most_in_memory, self._begun - self._safe)
        self.pixels[line] = np.zeros(SHAPE, np.uint16)
        return self.pixels[line]

    async def append(self, line: int) -> range:
        assert line == self._appended, f"line {line} appended where {self._appended} was due"
        self._appended += 1
        if line == self._fail_at_line:
            raise OSError(28, "No space left on device")
        return await self.flush() if self._appended % self._batch == 0 else range(0)

    async def flush(self) -> range:
        if self._store_ms:
            await asyncio.sleep(self._store_ms * 1e-3)
        safe = range(self._safe, self._appended)
        for line in safe:
            missing = line in self.records.missing
            self.records.stamps["stored"][line] = now_ns()
            self.records.status[line] = LineStatus.MISSING if missing else LineStatus.STORED
        self._safe = self._appended
        return safe

    async def close(self) -> None:
        if self.opened and not self.closed:
            await asyncio.sleep(0.001)
        self.closed = True
