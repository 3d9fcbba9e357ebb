"""From what the operating system and pyserial say of a port to the errors of scanhsi.devices."""

from __future__ import annotations

import errno

from scanhsi.devices.errors import DeviceBusy, DeviceError, DeviceLost, DeviceNotFound, DeviceUnavailable


def open_error(error: Exception, port: str, device: str) -> DeviceError:
    """Why a port cannot be opened (pyserial raises its own errors, OSError and ValueError)."""
    code = getattr(error, "errno", None)
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


def lost_error(cause: BaseException | None, device: str) -> DeviceLost:
    """The port was open and is gone."""
    why = f" ({cause})" if cause else ""
    return DeviceLost(f"the connection is gone{why}.", device=device, hint="check the USB cable, then connect anew.")
