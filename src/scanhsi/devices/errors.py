"""The one error tree of scanhsi.

::

    ScanhsiError
    ├── DeviceError
    │   ├── DeviceNotFound       nothing answers at that address, port or name
    │   ├── DeviceBusy           another process or task holds the device
    │   ├── DeviceLost           the device was there and is gone; what it was told may or may not have happened
    │   ├── DeviceTimeout        no answer within the deadline of that operation
    │   ├── DeviceUnavailable    a library or permission this driver needs is missing on this computer
    │   ├── UnsupportedFeature   the device, or this driver of it, cannot do that
    │   ├── OutOfRange           refused before anything happened: the value is not one the device allows
    │   ├── ProtocolError        the device answered something that its protocol does not allow
    │   ├── MotionFailed         a motion did not end where it should have: stopped, stalled, home sensor not found
    │   ├── PositionLost         the actuator no longer knows where it is; home it before the next move
    │   ├── FrameLost            a frame was exposed and will never arrive whole
    │   └── DeviceUnsafe         it did not confirm that it is in its safe state: the mirror may be moving, the light be on
    ├── ConfigError              an instrument file, a plan or an option is wrong; lists every problem found
    ├── CubeError                a cube cannot be created, written or read
    │   ├── CubeExists           the output is there already; nothing was touched
    │   └── NotACube             the path holds something else, or nothing
    ├── CalibrationError         a reference or calibration cannot be made, or does not fit what it is to be used on
    └── ScanFailed               a scan ended early; says why and how many lines are safe

A driver maps every exception of its vendor's library to one of these and raises it ``from`` the original.
A message says what happened and to which device; ``hint`` says what to try.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence


class ScanhsiError(Exception):
    """Root of every error that scanhsi raises on purpose.

    Args:
        message: What happened, in one sentence.
        device: Name of the device, as its driver calls it (``"camera aravis 192.168.1.20"``).
        operation: What was being done (``"expose"``, ``"move_to 412"``).
        line: Line of the scan, counted from 0, where one was being taken.
        waited_s: Seconds waited before giving up, for deadlines.
        hint: What the user can try.
    """

    def __init__(
        self,
        message: str,
        *,
        device: str | None = None,
        operation: str | None = None,
        line: int | None = None,
        waited_s: float | None = None,
        hint: str | None = None,
    ) -> None:
        super().__init__(message)
        self.message = message
        self.device = device
        self.operation = operation
        self.line = line
        self.waited_s = waited_s
        self.hint = hint

    def __str__(self) -> str:
        place = ", ".join(
            part
            for part in (
                self.device,
                self.operation,
                None if self.line is None else f"line {self.line}",
                None if self.waited_s is None else f"waited {self.waited_s:.3g} s",
            )
            if part
        )
        text = f"{place}: {self.message}" if place else self.message
        return f"{text} Try: {self.hint}" if self.hint else text


class DeviceError(ScanhsiError):
    """Something about one device; see the subclasses for what can be done about it."""


class DeviceNotFound(DeviceError):
    """Nothing answers at that address, port or name. Raised by ``connect`` only."""


class DeviceBusy(DeviceError):
    """Another process holds the device, or another operation is under way. Nothing was changed."""


class DeviceLost(DeviceError):
    """The device was connected and is gone. Every pending and later call raises this until it is connected anew."""


class DeviceTimeout(DeviceError):
    """No answer within the deadline. The device may still carry out what it was asked."""


class DeviceUnavailable(DeviceError):
    """A library, a permission or a tool that this driver needs is missing; the hint says how to get it."""


class UnsupportedFeature(DeviceError):
    """The device or its driver cannot do that; raised before anything moves."""


class OutOfRange(DeviceError, ValueError):
    """A value the device does not allow; raised before anything happens, with the allowed range in the message."""


class ProtocolError(DeviceError):
    """The device answered something that its protocol does not allow: a firmware mismatch, or noise."""


class MotionFailed(DeviceError):
    """A motion ended somewhere else than commanded; the position is known."""


class PositionLost(DeviceError):
    """The actuator no longer knows its position (reset, lost steps). Home it before the next move."""


class FrameLost(DeviceError):
    """A frame was exposed and will never arrive whole (lost packets, no free buffer)."""


class DeviceUnsafe(DeviceError):
    """A device was told to be safe (mirror still, light off) and did not confirm it: look at the instrument."""


class ConfigError(ScanhsiError, ValueError):
    """A configuration, a plan or an option is wrong.

    Args:
        message: What was being read.
        problems: One sentence a problem: key, value found, what is allowed.
    """

    def __init__(self, message: str, problems: Sequence[str] = (), *, hint: str | None = None) -> None:
        super().__init__("\n  - ".join([message, *problems]), hint=hint)
        self.problems = tuple(problems)


class CubeError(ScanhsiError):
    """A cube cannot be created, written or read."""


class CubeExists(CubeError):
    """The output exists already. Nothing was touched: scanhsi never overwrites a measurement."""


class NotACube(CubeError):
    """The path holds something that is not a scanhsi cube, or nothing at all."""


class CalibrationError(ScanhsiError, ValueError):
    """A reference or calibration cannot be made from this, or does not fit what it is to be used on."""


class ScanFailed(ScanhsiError):
    """A scan ended before its last line. The one exception that a scan raises.

    Attributes:
        causes: What went wrong, first cause first (cleanup failures after it).
        stored: Number of lines whose data is safe on disk.
        lines: Number of lines that were planned.
        output: Path of the partial cube, or None when nothing was being stored.
        lost: Devices that have to be opened anew before they are used again (``camera``, ``actuator``, ``light``), and what
            happened to each.
    """

    def __init__(
        self,
        causes: Sequence[BaseException],
        *,
        stored: int,
        lines: int,
        output: str | None = None,
        lost: Mapping[str, str] | None = None,
    ) -> None:
        first = causes[0]
        reason = str(first) if isinstance(first, ScanhsiError) else f"{type(first).__name__}: {first}"
        where = f" in {output}" if output else ""
        text = f"scan failed with {stored} of {lines} lines stored{where}: {reason}"
        for cause in causes[1:]:
            text = f"{text.rstrip('.')}; then {type(cause).__name__}: {cause}"
        super().__init__(text)
        self.causes = tuple(causes)
        self.stored = stored
        self.lines = lines
        self.output = output
        self.lost = dict(lost or {})

    @property
    def unsafe(self) -> tuple[DeviceUnsafe, ...]:
        """Devices that may not be in their safe state; empty where all confirmed that they are."""
        return tuple(cause for cause in self.causes if isinstance(cause, DeviceUnsafe))
