"""The simulated actuator: turns the bench's mirror, in times drawn from a delay profile.

A move costs ``T_rand + T_act(steps) + settle``. T_rand is what the host's operating system adds now and then: the paper
cannot say to which stage, and here the serial call pays for it; the mirror stands still meanwhile, and during T_cmd, the first
part of T_act, in which the command is on its way. During all the rest the mirror counts as moving; where the profile has no T_cmd,
during all of T_act, though part of it is serial exchange: so an exposure that begins too early is always seen.
"""

from __future__ import annotations

import asyncio
import math

from scanhsi.clock import now_ns, sleep_until_ns
from scanhsi.devices import ActuatorInfo, Motion, Range, Sighting, Sweep
from scanhsi.devices.errors import DeviceBusy, DeviceError, MotionFailed
from scanhsi.timing.delays import Stream
from scanhsi.timing.distributions import least_s
from scanhsi.timing.replay import delay_streams
from scanhsi_sim.bench import Mirror, bench
from scanhsi_sim.options import ActuatorOptions, find_profile

_RUN_UP_S = 0.05


class SimulatedActuator:
    """Obeys the actuator contract and sweeps, with a trigger cable to the camera on the same bench."""

    def __init__(self, options: ActuatorOptions) -> None:
        self._options = options
        self._bench = bench(options.bench)
        self._profile = find_profile(options.profile)
        self._streams = delay_streams(self._profile, options.seed, options.block_lines)
        self._name = f"actuator simulated {options.bench}"
        self._info: ActuatorInfo | None = None
        self._position = 0
        self._homed = False
        self._halted = asyncio.Event()
        self._prepared: Sweep | None = None

    @property
    def info(self) -> ActuatorInfo:
        """What the actuator is and allows."""
        if self._info is None:
            raise DeviceError("it is not connected.", device=self._name, operation="info")
        return self._info

    @property
    def position(self) -> int:
        """Last confirmed position, in steps."""
        return self._position

    @property
    def homed(self) -> bool:
        """Whether step 0 is the home position."""
        return self._homed

    async def connect(self) -> None:
        """Take the actuator's place on the bench. The mirror stands at step 0 and is not homed, as after power-up."""
        self._bench.claim("actuator", self, self._name)
        options = self._options
        self._bench.mirror = Mirror(errors=options.mirror, seed=options.seed)
        self._position, self._homed, self._prepared = 0, False, None
        self._halted = asyncio.Event()  # of this event loop
        self._info = ActuatorInfo(
            name=self._name,
            model="simulated mirror",
            firmware=f"delay profile {self._profile.name} ({self._profile.mark})",
            steps_per_revolution=options.steps_per_revolution,
            limits=Range(*options.limits, step=1, unit="steps"),
            max_rate_steps_s=options.max_rate_steps_s,
            settle_s=self._profile.mean_s("settle"),
            simulated=True,
        )

    async def close(self) -> None:
        """Stop, and leave the bench."""
        await self.stop()
        self._info = None
        self._bench.release("actuator", self)

    async def home(self) -> Motion:
        """Turn to the home position and make it step 0."""
        self._ready("home")
        commanded_ns = now_ns()
        end_ns = commanded_ns + round(self._options.home_s * 1e9)
        self._homed = False
        self._bench.mirror.move(commanded_ns, end_ns, 0)
        await self._arrive(end_ns, 0, "home")
        self._homed = True
        return Motion(0, commanded_ns, now_ns())

    async def move_to(self, step: int) -> Motion:
        """Move to a step; return at the end of motion and settle."""
        self._ready("move_to")
        self.info.limits.check("step", step, device=self._name)
        return await self._move(step, f"move_to {step}")

    async def _move(self, step: int, operation: str) -> Motion:
        commanded_ns, line = now_ns(), self._bench.exposures
        steps = abs(step - self._position)
        act_ns = self._delay_ns("T_act", line, steps)
        sent_ns = commanded_ns + self._delay_ns("T_rand", line)
        started_ns = sent_ns + min(self._delay_ns("T_cmd", line), act_ns)
        end_ns = sent_ns + act_ns + self._delay_ns("settle", line)
        self._bench.mirror.move(started_ns, end_ns, step)
        await self._arrive(end_ns, step, operation)
        return Motion(step, commanded_ns, now_ns(), started_ns=started_ns)

    def least_latency_s(self, step: int) -> float:
        """The shortest T_rand and T_cmd that the profile can draw, for any step; nothing is sure of recorded ones."""
        del step
        if self._profile.scans:
            return 0.0
        streams: tuple[Stream, ...] = ("T_rand", "T_cmd")
        return sum(least_s(found) for stream in streams if (found := self._profile.distribution(stream)))

    async def stop(self) -> None:
        """Stop the mirror where it is."""
        self._prepared = None
        self._position = self._bench.mirror.halt(now_ns())
        self._halted.set()

    def check_sweep(self, sweep: Sweep) -> Sweep:
        """Refuse a sweep outside speed and limits."""
        speeds = Range(1e-3, self.info.max_rate_steps_s, unit="steps/s")
        speeds.check("sweep rate", sweep.rate_steps_s, device=self._name)
        for name, step in zip(("start of the run-up", "end of the run-out"), self._ends(sweep), strict=True):
            self.info.limits.check(name, step, device=self._name)
        return sweep

    def extent(self, sweep: Sweep) -> tuple[int, int]:
        """Lowest and highest step of a sweep, run-up and run-out included."""
        ends = self._ends(sweep)
        return min(ends), max(ends)

    def run_up_s(self, sweep: Sweep) -> float:
        """Mean time from the call of `sweep` until the mirror passes its first line."""
        latency_s = self._profile.mean_s("T_rand") + self._profile.mean_s("T_act")
        return latency_s + _run_up(sweep) / sweep.rate_steps_s

    async def prepare_sweep(self, sweep: Sweep) -> Motion:
        """Move to the start of the run-up."""
        self._ready("prepare_sweep")
        self.check_sweep(sweep)
        motion = await self._move(self._ends(sweep)[0], "prepare_sweep")
        self._prepared = sweep
        return motion

    async def sweep(self, sweep: Sweep) -> Motion:
        """Run the prepared sweep at constant speed, with a pulse at each line where asked."""
        self._ready("sweep")
        if self._prepared != sweep:
            raise DeviceError("this sweep is not prepared.", device=self._name, operation="sweep")
        self._prepared = None
        line = self._bench.exposures
        begin_ns = now_ns() + self._delay_ns("T_rand", line) + self._delay_ns("T_act", line)
        start, end = self._ends(sweep)
        end_ns = begin_ns + round(abs(end - start) / sweep.rate_steps_s * 1e9)
        self._bench.mirror.move(begin_ns, end_ns, end)
        passes_ns = [_pass_ns(sweep, begin_ns, line) for line in range(sweep.count)]
        for when_ns in passes_ns if sweep.pulses else ():
            await self._arrive(when_ns, None, "sweep")
            self._bench.pulse(when_ns)
        await self._arrive(end_ns, end, "sweep")
        return Motion(end, passes_ns[0], now_ns(), pulses=sweep.count if sweep.pulses else 0)

    async def locate(self) -> Sighting:
        """Where the mirror is, exactly: the step it passed last."""
        if self._info is None:
            raise DeviceError("it is not connected.", device=self._name, operation="locate")
        at_ns = now_ns()
        place, ahead = self._bench.mirror.position(at_ns), self._bench.mirror.position(at_ns + 1000)
        step = math.floor(place + 1e-3) if ahead >= place else math.ceil(place - 1e-3)
        return Sighting(step, at_ns, 0)

    def true_span(self, start_ns: int, end_ns: int) -> tuple[int, int]:
        """Lowest and highest step of the mirror between two times: what really happened, for `scanhsi.testing.witness`."""
        return self._bench.mirror.span(start_ns, end_ns)

    def _delay_ns(self, stream: Stream, line: int, steps: int = 0) -> int:
        return self._streams.delay_ns(stream, line, pixel_format=self._bench.pixel_format, steps=steps)

    def _ends(self, sweep: Sweep) -> tuple[int, int]:
        """Steps at which the run-up begins and the run-out ends: a line is exposed behind its place, so the run-out is longer."""
        way = _run_up(sweep) if sweep.every > 0 else -_run_up(sweep)
        return sweep.first - way, sweep.last + way + sweep.every

    def _ready(self, operation: str) -> None:
        if self._info is None:
            raise DeviceError("it is not connected.", device=self._name, operation=operation)
        if self._bench.mirror.still_from_ns > now_ns():
            raise DeviceBusy(
                "the mirror is still moving.", device=self._name, operation=operation, hint="stop it first."
            )
        self._halted.clear()

    async def _arrive(self, when_ns: int, step: int | None, operation: str) -> None:
        """Wait until the mirror is there; a stop on the way raises."""
        try:
            async with asyncio.timeout_at(when_ns * 1e-9):
                await self._halted.wait()
        except TimeoutError:
            await sleep_until_ns(when_ns)
            if step is not None:
                self._position = step
            return
        raise MotionFailed(f"it was stopped at step {self._position}.", device=self._name, operation=operation)


def _run_up(sweep: Sweep) -> int:
    """Steps to come up to speed before the first line."""
    return max(abs(sweep.every), math.ceil(sweep.rate_steps_s * _RUN_UP_S))


def _pass_ns(sweep: Sweep, begin_ns: int, line: int) -> int:
    return begin_ns + round((_run_up(sweep) + line * abs(sweep.every)) / sweep.rate_steps_s * 1e9)
