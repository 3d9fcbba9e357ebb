"""The actuator: an Arduino with the scanhsi stepper firmware on a serial port."""

from __future__ import annotations

import asyncio
import contextlib

from scanhsi.clock import now_ns, sleep_until_ns
from scanhsi.devices.actuator import ActuatorInfo, Motion
from scanhsi.devices.capabilities import Sighting, Sweep
from scanhsi.devices.errors import (
    DeviceBusy,
    DeviceError,
    DeviceNotFound,
    DeviceTimeout,
    MotionFailed,
    PositionLost,
    ProtocolError,
)
from scanhsi.devices.values import Range
from scanhsi_serial import close_port, open_port
from scanhsi_stepper.errors import boot_error, device_name, fail_error
from scanhsi_stepper.link import Counters, StepperLink
from scanhsi_stepper.motions import Finished, halt, read_status, run_motion
from scanhsi_stepper.options import StepperOptions
from scanhsi_stepper.protocol import SEQ_MAX, encode
from scanhsi_stepper.ramp import Profile, move_time_s
from scanhsi_stepper.sweeps import SweepPlan, plan_sweep

FIRMWARE = "scanhsi-stepper"
FIRMWARE_VERSION = 1
_IDENTIFY_EVERY_S = 0.25
_CLOSE_S = 1.0
_UNDERSTAND_S = 0.5e-3  # host scheduling (0.2 ms) and the firmware's parsing (0.3 ms)
_LATCH_SPEED = 500  # of the firmware's homing
_WINDOW_STEPS = 400  # generous width of a home index, for the deadline of homing


class StepperActuator:
    """See `scanhsi.devices.actuator.Actuator` for the contract, `scanhsi.devices.capabilities` for `Sweeps` and `TellsStart`."""

    def __init__(self, options: StepperOptions) -> None:
        self._options = options
        self._name = device_name(options.port)
        self._link: StepperLink | None = None
        self._transport: asyncio.Transport | None = None
        self._info: ActuatorInfo | None = None
        self._position = 0
        self._position_lost = False
        self._homed = False
        self._speed: int | None = None  # top speed the controller is set to; None = unknown
        self._plan: SweepPlan | None = None  # the sweep at whose start the mirror stands

    @property
    def info(self) -> ActuatorInfo:
        """What the actuator is and allows."""
        if self._info is None:
            raise DeviceError("not connected.", device=self._name, operation="info")
        return self._info

    @property
    def position(self) -> int:
        """Last position that the controller confirmed, in steps."""
        self._require_position("position")
        return self._position

    @property
    def homed(self) -> bool:
        """Whether step 0 is the home position."""
        return self._homed

    @property
    def counters(self) -> Counters:
        """What happened on the serial line since ``connect``."""
        return self._connected("counters").counters

    # --- connection -----------------------------------------------------------------------------------------------

    async def connect(self) -> None:
        """Open the port, wait for the controller to answer and set it up. Moves nothing."""
        if self._link is not None and not self._link.lost.is_set():
            raise DeviceBusy("already connected.", device=self._name, operation="connect")
        await self._close_port()
        options = self._options
        self._transport, link = await open_port(options.port, options.baud, self._new_link, self._name)
        link.attach(self._transport)
        self._link = link
        try:
            self._info = self._describe(await self._identify(link))
            self._position_lost, self._plan = False, None
            self._homed = options.home_direction is None  # no switch: the controller's count is all there is
            await self._halt(link)  # a motion that an earlier program left running; also asks for the position
            await self._set_up(link)
        except BaseException:
            await self._close_port()
            raise

    async def close(self) -> None:
        """Stop, then close the port."""
        if self._link is not None and not self._link.lost.is_set():
            with contextlib.suppress(DeviceError):
                await self.stop()
        await self._close_port()

    def _new_link(self) -> StepperLink:
        options = self._options
        return StepperLink(options.port, options.reply_timeout_s, options.reply_attempts, self._on_boot)

    async def _close_port(self) -> None:
        link, transport = self._link, self._transport
        self._link = self._transport = None
        if link is not None and transport is not None:
            await close_port(transport, link.lost, _CLOSE_S)

    async def _identify(self, link: StepperLink) -> tuple[str, ...]:
        """Ask until it answers: opening the port restarts an Arduino, whose bootloader then listens for 1.6 s."""
        limit_s = self._options.start_timeout_s
        began = now_ns()
        while now_ns() - began < limit_s * 1e9:
            sent = now_ns()
            with contextlib.suppress(DeviceTimeout, PositionLost):  # nothing yet, or it has just restarted
                return await link.request("I", attempts=1)
            await sleep_until_ns(sent + round(_IDENTIFY_EVERY_S * 1e9))
        damaged = link.counters.bad_lines + link.counters.noise
        raise DeviceNotFound(
            f"nothing that speaks the stepper protocol answers ({damaged} unreadable lines).",
            device=self._name,
            operation="connect",
            waited_s=limit_s,
            hint="wrong baud rate?" if damaged else "is the firmware flashed, and the baud rate right?",
        )

    def _describe(self, words: tuple[str, ...]) -> ActuatorInfo:
        if len(words) != 3 or words[0] != FIRMWARE or words[1] != str(FIRMWARE_VERSION):
            raise ProtocolError(
                f"the controller is {' '.join(words)!r}; this driver speaks to {FIRMWARE} {FIRMWARE_VERSION}.",
                device=self._name,
                operation="connect",
                hint="flash the firmware that came with this driver.",
            )
        options = self._options
        return ActuatorInfo(
            name=self._name,
            model=f"{words[0]} {words[2]}",
            firmware=words[1],
            steps_per_revolution=options.steps_per_revolution,
            limits=Range(options.minimum_step, options.maximum_step, 1, "steps"),
            max_rate_steps_s=options.top_speed_steps_s,
            backlash_steps=options.backlash_steps,
            settle_s=options.settle_s,
            simulated=options.simulated,
            finds_home=options.home_direction is not None,
        )

    async def _set_up(self, link: StepperLink) -> None:
        """Make the settings that a restart of the controller forgets."""
        options = self._options
        await link.request("E 1")
        await link.request(f"A {options.acceleration_steps_s2}")
        await link.request(f"B {options.start_speed_steps_s}")
        self._speed = None
        await self._use_speed(link, options.top_speed_steps_s)

    async def _use_speed(self, link: StepperLink, speed: int) -> None:
        if speed != self._speed:
            self._speed = None
            await link.request(f"V {speed}")
            self._speed = speed

    # --- motion ---------------------------------------------------------------------------------------------------

    async def home(self) -> Motion:
        """Find the home switch and make its edge step 0; without a switch take the present position as 0."""
        link, options = self._connected("home"), self._options
        commanded = now_ns()
        self._homed, self._plan = False, None
        if self._position_lost:
            await self._set_up(link)
        if options.home_direction is None:
            await link.request("Z 0")
        else:
            await self._use_speed(link, options.top_speed_steps_s)
            await self._run(link, f"H {options.home_direction} {options.home_limit_steps}", 0, self._home_time_s())
            await self._settle()
        self._position, self._position_lost, self._homed = 0, False, True
        return Motion(0, commanded, now_ns())

    async def move_to(self, step: int) -> Motion:
        """Move to ``step``; return at the end of motion and settle."""
        operation = f"move_to {step}"
        link = self._connected(operation)
        self._require_position(operation)
        self.info.limits.check("step", step, device=self._name)
        commanded, origin = now_ns(), self._position
        self._plan = None
        started = [await self._go(link, goal) for goal in self._goals(step)]
        if step != origin:
            await self._settle()
        return Motion(self._position, commanded, now_ns(), started_ns=started[0])

    def least_latency_s(self, step: int) -> float:
        """The time that the command needs on the wire."""
        link = self._connected("least_latency_s")
        return self._wire_s(len(encode(link.next_seq, f"MA {self._goals(step)[0]}")))

    async def stop(self) -> None:
        """Stop whatever moves; return when the mirror stands still."""
        self._plan = None
        await self._halt(self._connected("stop"))

    async def _halt(self, link: StepperLink) -> None:
        options = self._options
        status, abrupt = await halt(
            link, options.top_speed_steps_s / options.acceleration_steps_s2 + options.motion_margin_s
        )
        self._position = status.position
        if abrupt:
            self._lose_position()

    def _goals(self, step: int) -> tuple[int, ...]:
        """Where to go, one after the other, to get to a step from where the mirror stands."""
        if self._options.backlash_steps and step < self._position:
            return step - self._options.backlash_steps, step
        return (step,)

    async def _go(self, link: StepperLink, step: int) -> int:
        """Move; return the earliest time at which the motor can have begun: its command had come over the wire.

        The controller's own lines would tell it later than it was: a USB bridge keeps them for up to 16 ms, a busy computer longer.
        """
        profile, command = self._options.profile, f"MA {step}"
        await self._use_speed(link, profile.top_speed)
        finished = await self._run(link, command, step, move_time_s(step - self._position, profile))
        return finished.commanded_ns + round(self._wire_s(len(encode(finished.seq, command))) * 1e9)

    def _wire_s(self, count: int) -> float:
        """Time of so many bytes on the wire."""
        return count * 10 / self._options.baud

    async def _run(self, link: StepperLink, command: str, goal: int | None, expected_s: float) -> Finished:
        """Do one motion; `goal` is where it has to end (None = wherever)."""
        finished = await run_motion(link, command, expected_s, self._options.motion_margin_s)
        self._position = finished.position
        if not finished.reached or (goal is not None and finished.position != goal):
            raise fail_error(finished.code, finished.position, self._options.port, command)
        return finished

    async def _settle(self) -> None:
        await sleep_until_ns(now_ns() + round(self._options.settle_s * 1e9))

    def _home_time_s(self) -> float:
        """Longest that homing can take: seek, overshoot and back, creep to the edge."""
        profile = self._options.profile
        back = 2 * profile.ramp_steps + _WINDOW_STEPS
        creep = Profile(min(_LATCH_SPEED, profile.top_speed), profile.acceleration, profile.start_speed)
        seek = move_time_s(self._options.home_limit_steps, profile)
        return seek + move_time_s(back, profile) + move_time_s(back, creep)

    # --- sweeps ---------------------------------------------------------------------------------------------------

    def check_sweep(self, sweep: Sweep) -> Sweep:
        """Refuse a sweep that cannot be done; return it with the rate in whole steps/s, rounded down."""
        return plan_sweep(sweep, self._options).sweep

    def extent(self, sweep: Sweep) -> tuple[int, int]:
        """Lowest and highest step of a sweep: the start of its run-up and the end of its run-out, or the other way round."""
        plan = plan_sweep(sweep, self._options)
        return min(plan.start, plan.end), max(plan.start, plan.end)

    def run_up_s(self, sweep: Sweep) -> float:
        """Time from the call of `sweep` until the mirror passes ``first``: the request on the wire, then the ramp."""
        plan = plan_sweep(sweep, self._options)
        request_s = self._wire_s(len(encode(SEQ_MAX, plan.command)))
        return request_s + _UNDERSTAND_S + plan.run_up_s

    async def prepare_sweep(self, sweep: Sweep) -> Motion:
        """Move to the start of the run-up and set the sweep's speed."""
        plan = plan_sweep(sweep, self._options)
        motion = await self.move_to(plan.start)
        await self._use_speed(self._connected("prepare_sweep"), int(plan.sweep.rate_steps_s))
        self._plan = plan
        return motion

    async def sweep(self, sweep: Sweep) -> Motion:
        """Run the prepared sweep; return when the mirror stands again behind the last line."""
        link = self._connected("sweep")
        self._require_position("sweep")
        plan, self._plan = self._plan, None
        if plan is None or plan != plan_sweep(sweep, self._options):
            raise DeviceError(
                "this sweep was not prepared.", device=self._name, operation="sweep", hint="call prepare_sweep first."
            )
        finished = await self._run(link, plan.command, None if sweep.pulses else plan.end, plan.expected_s)
        pulses = 0
        if sweep.pulses:
            pulses = sweep.count if finished.triggers is None else finished.triggers
            if pulses != sweep.count:
                raise MotionFailed(
                    f"it gave {pulses} of {sweep.count} trigger pulses.", device=self._name, operation="sweep"
                )
        await self._settle()
        return Motion(self._position, finished.began_ns + round(plan.run_up_s * 1e9), now_ns(), pulses)

    async def locate(self) -> Sighting:
        """Ask where the mirror is, also during a motion. The answer is some time between question and reply."""
        link = self._connected("locate")
        asked = now_ns()
        status = await read_status(link)
        answered = now_ns()
        return Sighting(status.position, (asked + answered) // 2, (answered - asked) // 2)

    # --- state ----------------------------------------------------------------------------------------------------

    def _on_boot(self) -> None:
        self._lose_position()
        self._speed = None

    def _lose_position(self) -> None:
        self._position_lost, self._homed, self._plan = True, False, None

    def _require_position(self, operation: str) -> None:
        if self._position_lost:
            raise boot_error(self._options.port, operation)

    def _connected(self, operation: str) -> StepperLink:
        if self._link is None:
            raise DeviceError("not connected.", device=self._name, operation=operation, hint="call connect first.")
        return self._link
