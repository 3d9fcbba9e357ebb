"""From what serial ports and the firmware say to the errors of scanhsi.devices: the one place where that is decided."""

from __future__ import annotations

import errno

from scanhsi.devices.errors import (
    DeviceBusy,
    DeviceError,
    DeviceLost,
    DeviceNotFound,
    DeviceUnavailable,
    MotionFailed,
    OutOfRange,
    PositionLost,
    ProtocolError,
)
from scanhsi_stepper.protocol import ErrorCode


def device_name(port: str) -> str:
    """How messages call the actuator at a port."""
    return f"actuator stepper {port}"


def open_error(error: Exception, port: str) -> DeviceError:
    """Why a port cannot be opened (pyserial raises its own errors, OSError and ValueError)."""
    device, code = device_name(port), getattr(error, "errno", None)
    if code == errno.ENOENT:
        return DeviceNotFound(
            "there is no such port.", device=device, hint="is it plugged in? `ls /dev/serial/by-id` lists ports."
        )
    if code in (errno.EACCES, errno.EPERM):
        return DeviceUnavailable(
            "no permission to open the port.",
            device=device,
            hint="add the user to group dialout (`sudo usermod -aG dialout $USER`) and log in again.",
        )
    if code in (errno.EAGAIN, errno.EBUSY):
        return DeviceBusy(
            "the port is in use by another program.",
            device=device,
            hint=f'`fuser {port}` names it; ModemManager is kept off with ENV{{ID_MM_DEVICE_IGNORE}}="1" in a udev rule.',
        )
    return DeviceNotFound(f"the port cannot be opened: {error}", device=device, hint="is it a serial port?")


def lost_error(cause: BaseException | None, port: str) -> DeviceLost:
    """The port was open and is gone."""
    why = f" ({cause})" if cause else ""
    return DeviceLost(
        f"the connection is gone{why}.", device=device_name(port), hint="check the USB cable, then connect anew."
    )


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
