"""From what the firmware says to the errors of scanhsi.devices: the one place where that is decided."""

from __future__ import annotations

from scanhsi.devices.errors import (
    DeviceBusy,
    DeviceError,
    MotionFailed,
    OutOfRange,
    PositionLost,
    ProtocolError,
)
from scanhsi_stepper.protocol import ErrorCode


def device_name(port: str) -> str:
    """How messages call the actuator at a port."""
    return f"actuator stepper {port}"


def boot_error(port: str, operation: str | None = None) -> PositionLost:
    """The controller has restarted under us."""
    return PositionLost(
        "the controller has restarted and no longer knows its position.",
        device=device_name(port),
        operation=operation,
        hint="home the mirror; if it comes again check its power supply.",
    )


def reply_error(code: int, port: str, operation: str) -> DeviceError:
    """An ERR reply."""
    device = device_name(port)
    if code == ErrorCode.BUSY:
        return DeviceBusy(
            "a motion is under way.", device=device, operation=operation, hint="wait for it or call stop()."
        )
    if code in (ErrorCode.BAD_ARGUMENT, ErrorCode.OUT_OF_RANGE):
        return OutOfRange("the controller refuses the value.", device=device, operation=operation)
    if code == ErrorCode.UNKNOWN_COMMAND:
        return ProtocolError(
            "the controller does not know this command.",
            device=device,
            operation=operation,
            hint="flash the firmware that came with this driver.",
        )
    return ProtocolError(f"the controller answers with unknown error {code}.", device=device, operation=operation)


def fail_error(code: int, position: int, port: str, operation: str) -> DeviceError:
    """A FAIL event, or a motion that turns out to have ended short of its goal (code 0)."""
    device = device_name(port)
    if code == ErrorCode.NO_HOME_SENSOR:
        return MotionFailed(
            "the home sensor was not found.",
            device=device,
            operation=operation,
            hint="check the switch, and the options home_direction and home_limit_steps.",
        )
    what = "was stopped" if code == ErrorCode.STOPPED else "did not reach its goal"
    return MotionFailed(f"the motion {what} at step {position}.", device=device, operation=operation)
