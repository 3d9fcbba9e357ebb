"""From GRBL's error and alarm numbers to the errors of scanhsi.devices: the one place where that is decided."""

from __future__ import annotations

from typing import Final

from scanhsi.devices.errors import (
    DeviceBusy,
    DeviceError,
    MotionFailed,
    OutOfRange,
    PositionLost,
    ProtocolError,
    UnsupportedFeature,
)

KEEPS_POSITION: Final = frozenset({2, 4, 5})
"""Alarms after which the controller still knows where it is."""

_ALARMS: Final = {
    1: "a limit switch was hit",
    2: "the target lies outside the controller's travel",
    3: "it was reset while it moved",
    4: "the probe is in the wrong state",
    5: "the probe was not touched",
    6: "it was reset while it homed",
    7: "the safety door was opened while it homed",
    8: "the home switch does not open again",
    9: "the home switch was not found",
}
_HOMING_FAILED: Final = frozenset({6, 7, 8, 9})


def device_name(port: str) -> str:
    """How messages call the actuator at a port."""
    return f"actuator grbl {port}"


def reply_error(code: int, device: str, operation: str) -> DeviceError:
    """An ``error:N``."""
    match code:
        case 8:
            return DeviceBusy(
                "it is not idle (error:8).", device=device, operation=operation, hint="wait for it or call stop()."
            )
        case 9:
            return PositionLost("it is locked (error:9).", device=device, operation=operation, hint="home the mirror.")
        case 5:
            return UnsupportedFeature(
                "homing is off (error:5).", device=device, operation=operation, hint="set $22=1 where it has a switch."
            )
        case 15:
            return OutOfRange("the target exceeds its travel (error:15).", device=device, operation=operation)
        case _:
            return ProtocolError(
                f"the controller refuses the line with error:{code}.",
                device=device,
                operation=operation,
                hint="GRBL's list of error codes says why; on a damaged line check the cable.",
            )


def alarm_error(code: int, device: str, operation: str | None) -> DeviceError:
    """An ``ALARM:N``."""
    what = f"{_ALARMS.get(code, 'it reports an alarm')} (ALARM:{code})."
    if code in _HOMING_FAILED:
        return MotionFailed(
            what,
            device=device,
            operation=operation,
            hint="check the switch, and the settings $23 to $27 and $130 to $132.",
        )
    if code in KEEPS_POSITION:
        return MotionFailed(what, device=device, operation=operation, hint="home the mirror to unlock it.")
    return PositionLost(what, device=device, operation=operation, hint="home the mirror.")


def restart_error(device: str, operation: str | None = None) -> PositionLost:
    """The controller has restarted under us."""
    return PositionLost(
        "the controller has restarted and no longer knows its position.",
        device=device,
        operation=operation,
        hint="home the mirror; if it comes again check its power supply.",
    )
