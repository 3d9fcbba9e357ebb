"""One motion from its command to its end, and stopping: what is common to moves, homing and sweeps."""

from __future__ import annotations

import asyncio
import contextlib
from dataclasses import dataclass

from scanhsi.clock import now_ns, sleep_until_ns
from scanhsi.devices.errors import DeviceError, DeviceTimeout, PositionLost, ProtocolError
from scanhsi_stepper.errors import device_name
from scanhsi_stepper.link import Running, StepperLink
from scanhsi_stepper.protocol import Status

_POLL_NS = 500_000_000  # how often a motion that should end by itself is asked about
_STOP_POLL_S = 0.02
_STOP_ATTEMPTS = 3  # against restarts of the controller in between
_WIRE_S = 10 / 115_200  # one byte
_OK_BYTES, _DONE_BYTES = 12, 28


@dataclass(frozen=True, slots=True)
class Finished:
    """The end of a motion.

    Attributes:
        reached: It ended by itself (DONE).
        code: Of the FAIL event; 0 where that was lost.
        position: Where, in steps.
        triggers: Pulses given; None where the DONE event was lost.
        commanded_ns: When the command was given; loop clock.
        began_ns: When the controller began, estimated from the arrival of its lines.
        seq: Of the request.
    """

    reached: bool
    code: int
    position: int
    triggers: int | None
    commanded_ns: int
    began_ns: int
    seq: int


async def run_motion(link: StepperLink, command: str, expected_s: float, margin_s: float) -> Finished:
    """Begin a motion and wait for its end.

    A lost DONE is made up for by asking: when a damaged line has come, soon after `expected_s` (its duration, or a bound of it),
    and every half second. `margin_s` after that the motor is stopped.

    Raises:
        DeviceTimeout: It did not end in time; it was told to stop.
        DeviceError: As `StepperLink.request`.
    """
    running = await link.start(command)
    try:
        finished = await _end_of(link, running, expected_s, margin_s)
    finally:
        link.forget(running)
    if finished is not None:
        return finished
    await link.request("S")
    raise DeviceTimeout(
        "the motion does not end; it was stopped.",
        device=device_name(link.port),
        operation=command,
        waited_s=expected_s + margin_s,
    )


async def _end_of(link: StepperLink, running: Running, expected_s: float, margin_s: float) -> Finished | None:
    deadline = running.confirmed_ns + round((expected_s + margin_s) * 1e9)
    due = now_ns() + round((expected_s + link.reply_timeout_s) * 1e9)
    while (left_ns := deadline - (now := now_ns())) > 0:
        patience_ns = min(left_ns, due - now if due > now else _POLL_NS, _POLL_NS)
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(patience_ns * 1e-9):
                await running.news.wait()
        running.news.clear()
        status = None if running.end.done() else await read_status(link)
        if running.end.done():
            return _from_event(running)
        if status is not None and status.mode == 0:
            return _from_status(link, running, status)
    return None


def _from_event(running: Running) -> Finished:
    arrived = running.end.result()  # raises when the controller restarted or the port is gone
    end = arrived.message
    # Both confirmations came late, never early: the earlier one is nearer to the truth.
    by_ok = running.confirmed_ns - round(_OK_BYTES * _WIRE_S * 1e9)
    by_done = arrived.at_ns - end.us * 1000 - round(_DONE_BYTES * _WIRE_S * 1e9)
    began = max(min(by_ok, by_done), running.commanded_ns)
    return Finished(end.code == 0, end.code, end.position, end.triggers, running.commanded_ns, began, running.seq)


def _from_status(link: StepperLink, running: Running, status: Status) -> Finished:
    """The controller stands still and its DONE or FAIL has not come: only DONE is noted in ``done_seq``."""
    reached = status.done_seq == running.seq
    link.counters.done_by_poll += reached
    return Finished(reached, 0, status.position, None, running.commanded_ns, running.commanded_ns, running.seq)


async def read_status(link: StepperLink) -> Status:
    """Ask for the controller's state.

    Raises:
        ProtocolError: The answer has another form.
        DeviceError: As `StepperLink.request`.
    """
    words = await link.request("Q")
    try:
        return Status.of(words)
    except ValueError:
        raise ProtocolError(
            f"the state {' '.join(words)!r} has another form.", device=device_name(link.port), operation="Q"
        ) from None


async def halt(link: StepperLink, limit_s: float) -> tuple[Status, bool]:
    """Stop with a ramp; if it does not stand still within `limit_s`, without one.

    Returns:
        The state at standstill, and whether the ramp was cut short, so that steps may have been lost.

    Raises:
        DeviceError: It cannot be known that the motor stands still.
    """
    await _until_answered(link, "S")
    deadline = now_ns() + round(limit_s * 1e9)
    abrupt = False
    while True:
        status = Status.of(await _until_answered(link, "Q"))
        if status.mode == 0:
            return status, abrupt
        if now_ns() < deadline:
            await sleep_until_ns(now_ns() + round(_STOP_POLL_S * 1e9))
        elif not abrupt:
            abrupt = True
            await _until_answered(link, "X")
        else:
            raise DeviceError(
                "the motor does not stop.", device=device_name(link.port), operation="stop", hint="cut its power."
            )


async def _until_answered(link: StepperLink, command: str) -> tuple[str, ...]:
    """A request that is harmless to repeat, also to a controller that has just restarted (and stands still)."""
    for _ in range(_STOP_ATTEMPTS - 1):
        try:
            return await link.request(command)
        except PositionLost:
            continue
    return await link.request(command)
