"""The actuator: one axis of a GRBL 1.1 controller on a serial port.

Moves are jogs in machine coordinates: absolute, so that one whose answer was lost is not done twice, and a jog can be cancelled
at any moment without losing the position. ``ok`` only says that a jog is queued; its end is seen in status reports.
"""

from __future__ import annotations

import asyncio
import contextlib
import math

from scanhsi.clock import now_ns, sleep_until_ns
from scanhsi.devices.actuator import ActuatorInfo, Motion
from scanhsi.devices.errors import (
    DeviceBusy,
    DeviceError,
    DeviceNotFound,
    DeviceTimeout,
    MotionFailed,
    OutOfRange,
    PositionLost,
    ProtocolError,
)
from scanhsi.devices.values import Range
from scanhsi_grbl.errors import KEEPS_POSITION, device_name, restart_error
from scanhsi_grbl.halt import halt
from scanhsi_grbl.link import GrblLink
from scanhsi_grbl.options import GrblOptions
from scanhsi_grbl.protocol import Feedback, Report, Setting
from scanhsi_grbl.settings import Axis, read_axis
from scanhsi_serial import close_port, open_port

_ASK_EVERY_S = 0.25
_QUIET_S = 0.3  # after its banner a controller may still print start-up lines
_LONGEST_SLEEP_S = 0.2
_CLOSE_S = 1.0


class GrblActuator:
    """See `scanhsi.devices.actuator.Actuator` for the contract."""

    def __init__(self, options: GrblOptions) -> None:
        self._options = options
        self._name = device_name(options.port)
        self._index = "xyz".index(options.axis)
        self._link: GrblLink | None = None
        self._transport: asyncio.Transport | None = None
        self._info: ActuatorInfo | None = None
        self._firmware = ""
        self._axis: Axis | None = None
        self._origin = 0  # machine step of our step 0
        self._position = 0
        self._position_lost = False
        self._homed = False
        self._homing = False
        self._stops = 0

    @property
    def info(self) -> ActuatorInfo:
        """What the actuator is and allows; limits are the narrower ones of the options and of the controller's soft limits."""
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
        """Whether step 0 is the home position; without a switch, whether the controller still counts from its start."""
        return self._homed

    # --- connection -----------------------------------------------------------------------------------------------

    async def connect(self) -> None:
        """Open the port, wait for the controller to answer and read its settings. Moves nothing."""
        if self._link is not None and not self._link.lost.is_set():
            raise DeviceBusy("already connected.", device=self._name, operation="connect")
        await self._close_port()
        options, first, before = self._options, self._info is None, self._position if self._homed else None
        self._transport, link = await open_port(options.port, options.baud, self._new_link, self._name)
        link.attach(self._transport)
        self._link, self._homing = link, False
        try:
            await self._greet(link)
            self._axis = await self._read_axis(link)
            self._use_origin(self._axis.home_step)
            report = await halt(link, self._stop_s(), homing=False)  # a motion that an earlier program left running
            self._position_lost = report.state == "Alarm"
            self._take_position(report)
            # Without a switch its count is all there is, and that begins anew whenever the controller does.
            still_counts = (first or before == self._position) and not self._position_lost
            self._homed = still_counts and not self._axis.homing
        except BaseException:
            await self._close_port()
            raise

    async def close(self) -> None:
        """Stop, then close the port."""
        if self._link is not None and not self._link.lost.is_set():
            with contextlib.suppress(DeviceError):
                await self.stop()
        await self._close_port()

    def _new_link(self) -> GrblLink:
        return GrblLink(self._name, self._options.reply_timeout_s, self._on_alarm)

    async def _close_port(self) -> None:
        link, transport = self._link, self._transport
        self._link = self._transport = None
        if link is not None and transport is not None:
            await close_port(transport, link.lost, _CLOSE_S)

    async def _greet(self, link: GrblLink) -> None:
        """Ask until it answers: opening the port restarts an Arduino, whose bootloader then listens for 1.6 s."""
        limit_s = self._options.start_timeout_s
        began = now_ns()
        patience, link.reply_timeout_s = link.reply_timeout_s, _ASK_EVERY_S
        try:
            while now_ns() - began < limit_s * 1e9:
                asked = now_ns()
                with contextlib.suppress(DeviceTimeout, PositionLost):
                    await link.status()
                    if link.started_ns is not None:
                        await sleep_until_ns(link.started_ns + round(_QUIET_S * 1e9))
                    return
                await sleep_until_ns(asked + round(_ASK_EVERY_S * 1e9))
        finally:
            link.reply_timeout_s = patience
        raise DeviceNotFound(
            f"nothing that speaks GRBL answers ({link.noise} unreadable lines).",
            device=self._name,
            operation="connect",
            waited_s=limit_s,
            hint="wrong baud rate?" if link.noise else "is GRBL 1.1 flashed, and the baud rate right?",
        )

    async def _read_axis(self, link: GrblLink) -> Axis:
        words = [said.text for said in await link.send("$I") if isinstance(said, Feedback)]
        version = next((word.removeprefix("VER:") for word in words if word.startswith("VER:")), "")
        if not version.startswith("1.1"):
            raise ProtocolError(
                f"the controller has GRBL {version.rstrip(':') or 'of unknown version'}; this driver speaks to 1.1.",
                device=self._name,
                operation="connect",
                hint="flash GRBL 1.1.",
            )
        self._firmware = version.rstrip(":")
        options = next((word.removeprefix("OPT:").partition(",")[0] for word in words if word.startswith("OPT:")), "")
        settings = {said.number: said.value for said in await link.send("$$") if isinstance(said, Setting)}
        return read_axis(settings, options, self._index, self._name)

    def _use_origin(self, machine_step: int) -> None:
        """Let this machine step be our step 0; the controller's travel becomes steps of ours."""
        options, axis = self._options, self._known_axis()
        self._origin = machine_step
        low, high = (limit - machine_step for limit in axis.travel_steps)
        low, high = math.ceil(max(options.minimum_step, low)), math.floor(min(options.maximum_step, high))
        if low >= high:
            raise OutOfRange(
                f"nothing is left between minimum_step {options.minimum_step}, maximum_step {options.maximum_step} and the "
                f"controller's own limits.",
                device=self._name,
                operation="connect",
                hint="see $20 and $130 to $132.",
            )
        self._info = ActuatorInfo(
            name=self._name,
            model=f"GRBL {self._firmware}, axis {options.axis}",
            firmware=self._firmware,
            steps_per_revolution=options.steps_per_revolution,
            limits=Range(low, high, 1, "steps"),
            max_rate_steps_s=self._rate_mm_min(axis) / 60 * axis.steps_per_mm,
            backlash_steps=options.backlash_steps,
            settle_s=options.settle_s,
            simulated=options.simulated,
            finds_home=axis.homing,
        )

    # --- motion ---------------------------------------------------------------------------------------------------

    async def home(self) -> Motion:
        """Find the home switch and make where that ends step 0; without one ($22=0) go to the controller's own zero."""
        link, axis = self._connected("home"), self._known_axis()
        commanded, self._homed = now_ns(), False
        if self._position_lost or (await link.status()).state == "Alarm":
            await link.reset()  # an alarm of a limit needs one; any other does not mind
            if not axis.homing:
                await link.send("$X")
        if axis.homing:
            await self._seek_switch(link)
        report = await link.status()
        self._use_origin(axis.steps(self._machine_mm(report)) if axis.homing else 0)
        self._take_position(report)
        self._position_lost = False
        if self._position:
            await self._go(link, 0, self._stops)
        await self._settle()
        self._homed = True
        return Motion(self._position, commanded, now_ns())

    async def _seek_switch(self, link: GrblLink) -> None:
        self._lose_position()
        self._homing = True  # and so it stays when this is cancelled: `stop` then knows that only a reset helps
        restarted = link.restart()  # where homing fails the controller restarts by itself
        try:
            await link.send(self._options.home_command, self._options.home_timeout_s)
        except MotionFailed:
            self._homing = False
            with contextlib.suppress(DeviceError):
                await link.await_restart(restarted)
            raise
        except DeviceTimeout:
            await self.stop()
            raise
        finally:
            link.forget(restarted)
        self._homing = False

    async def move_to(self, step: int) -> Motion:
        """Move to ``step``; return at the end of motion and settle."""
        operation = f"move_to {step}"
        link = self._connected(operation)
        self._require_position(operation)
        self.info.limits.check("step", step, device=self._name)
        commanded, origin, stops = now_ns(), self._position, self._stops
        if self._options.backlash_steps and step < origin:
            await self._go(link, max(step - self._options.backlash_steps, int(self.info.limits.minimum)), stops)
        await self._go(link, step, stops)
        if step != origin:
            await self._settle()
        return Motion(self._position, commanded, now_ns())

    async def stop(self) -> None:
        """Stop whatever moves; return when the mirror stands still."""
        link = self._connected("stop")
        self._stops += 1
        report = await halt(link, self._stop_s(), homing=self._homing)
        self._homing = False
        self._take_position(report)
        if report.state == "Alarm":
            self._lose_position()

    async def _go(self, link: GrblLink, step: int, stops: int) -> None:
        """Jog to a step and wait until the controller stands; `stops` is the count of stops when the motion was asked for."""
        axis, operation = self._known_axis(), f"move_to {step}"
        rate = self._rate_mm_min(axis)
        expected_s = axis.move_time_s(step - self._position, rate)
        target = (step + self._origin) / axis.steps_per_mm
        if stops == self._stops:
            try:
                await link.send(f"$J=G53G90G21{self._options.axis.upper()}{target:.4f}F{rate:.3f}")
                report = await self._until_idle(link, expected_s)
            except DeviceTimeout as error:
                await self.stop()
                error.operation = operation
                raise
            self._take_position(report)
            if report.state == "Alarm":
                raise restart_error(self._name, operation) if self._position_lost else self._failed(operation)
        if stops != self._stops or self._position != step:
            raise self._failed(operation)

    def _failed(self, operation: str) -> MotionFailed:
        return MotionFailed(f"the motion ended at step {self._position}.", device=self._name, operation=operation)

    async def _until_idle(self, link: GrblLink, expected_s: float) -> Report:
        """Wait for a motion's end: seldom while it cannot be, then often.

        Raises:
            DeviceTimeout: It does not end.
        """
        began = now_ns()
        limit_s = expected_s + self._options.motion_margin_s
        while (passed_s := (now_ns() - began) * 1e-9) < limit_s:
            left_s = max(0.9 * expected_s - passed_s, self._options.poll_s)
            await sleep_until_ns(now_ns() + round(min(left_s, _LONGEST_SLEEP_S) * 1e9))
            report = await link.status()
            if report.state in ("Idle", "Alarm"):
                return report
        raise DeviceTimeout("the motion does not end; it was stopped.", device=self._name, waited_s=limit_s)

    async def _settle(self) -> None:
        await sleep_until_ns(now_ns() + round(self._options.settle_s * 1e9))

    def _rate_mm_min(self, axis: Axis) -> float:
        wanted = self._options.top_speed_steps_s
        return axis.rate_mm_min if wanted is None else min(axis.rate_mm_min, wanted * 60 / axis.steps_per_mm)

    def _stop_s(self) -> float:
        """Longest that stopping with a ramp can take."""
        axis = self._known_axis()
        return axis.rate_mm_min / 60 / axis.acceleration_mm_s2 + self._options.motion_margin_s

    # --- state ----------------------------------------------------------------------------------------------------

    def _machine_mm(self, report: Report) -> float:
        if report.machine is None or len(report.machine) <= self._index:
            raise ProtocolError(f"a report without axis {self._options.axis}.", device=self._name, operation="?")
        return report.machine[self._index]

    def _take_position(self, report: Report) -> None:
        self._position = self._known_axis().steps(self._machine_mm(report)) - self._origin

    def _on_alarm(self, code: int | None) -> None:
        if code not in KEEPS_POSITION:
            self._lose_position()

    def _lose_position(self) -> None:
        self._position_lost, self._homed = True, False

    def _require_position(self, operation: str) -> None:
        if self._position_lost:
            raise PositionLost(
                "the controller does not know its position.",
                device=self._name,
                operation=operation,
                hint="home the mirror.",
            )

    def _known_axis(self) -> Axis:
        if self._axis is None:
            raise DeviceError("not connected.", device=self._name, hint="call connect first.")
        return self._axis

    def _connected(self, operation: str) -> GrblLink:
        if self._link is None:
            raise DeviceError("not connected.", device=self._name, operation=operation, hint="call connect first.")
        return self._link
