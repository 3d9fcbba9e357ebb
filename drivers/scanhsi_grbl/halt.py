"""Stopping a GRBL controller, whatever it does."""

from __future__ import annotations

from contextlib import suppress

from scanhsi.clock import now_ns, sleep_until_ns
from scanhsi.devices.errors import DeviceError, DeviceLost, DeviceTimeout
from scanhsi_grbl.link import GrblLink
from scanhsi_grbl.protocol import Realtime, Report

_POLL_S = 0.02


async def halt(link: GrblLink, limit_s: float, *, homing: bool) -> Report:
    """Stop with a ramp where that is possible; return the report at standstill.

    Jogs are cancelled and runs held, which keeps the position; homing ends by a reset, and so does whatever does not stand
    after `limit_s`: then the controller raises an alarm, for the position is lost. A line whose answer was lost is given up by
    a reset, too, at standstill, where that costs nothing.

    Raises:
        DeviceError: It cannot be known that the motor stands still.
    """
    if homing:
        await link.reset()
    deadline, abrupt = now_ns() + round(limit_s * 1e9), False
    while True:
        report = await _step(link)
        if report is not None:
            return report
        if now_ns() < deadline:
            await sleep_until_ns(now_ns() + round(_POLL_S * 1e9))
        elif not abrupt:
            abrupt = True
            deadline += round(link.reply_timeout_s * 1e9)
            with suppress(DeviceTimeout):
                await link.reset()
        else:
            raise DeviceError("the motor does not stop.", device=link.device, operation="stop", hint="cut its power.")


async def _step(link: GrblLink) -> Report | None:
    """Tell it once more to stop; its report, if it stands and no line is on its way."""
    link.realtime(Realtime.CANCEL_JOG)
    try:
        report = await link.status()
    except DeviceLost:
        raise
    except DeviceError:  # an alarm, a restart, or no answer: ask again
        return None
    match report.state, report.stage:
        case "Run", _:
            link.realtime(Realtime.HOLD)
        case "Hold", 0:  # it stands: a reset keeps the position and forgets the rest of the way
            await link.reset()
        case (("Idle" | "Alarm" | "Sleep" | "Check"), _):
            return None if link.unanswered else report
        case "Door", 0 | 1:  # it stands, or is held
            return report
        case _:
            pass
    return None
