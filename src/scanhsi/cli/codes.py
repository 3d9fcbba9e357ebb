"""Exit codes of every command."""

from __future__ import annotations

import asyncio
from enum import IntEnum, unique
from typing import Final

from scanhsi.devices import errors


@unique
class ExitCode(IntEnum):
    """What the exit code of ``scanhsi`` means."""

    OK = 0
    SCAN_FAILED = 1
    USAGE = 2
    DEVICE = 3
    CUBE = 4
    UNSAFE = 5
    INTERNAL = 70
    INTERRUPTED = 130


EXIT_CODES: Final = (
    "0 done; 1 the scan ended early or lost lines, what was stored is safe; 2 wrong command line, instrument file or plan, "
    "nothing was moved; 3 a device is missing, busy, lost or fails; 4 a cube, reference or picture cannot be read, written or "
    "used, nothing was overwritten; 5 UNSAFE: the mirror may be moving, or the "
    "light be on; 70 a bug in scanhsi; 130 interrupted"
)

_CODES: Final[tuple[tuple[type[BaseException], ExitCode], ...]] = (
    (errors.DeviceUnsafe, ExitCode.UNSAFE),
    (errors.ScanFailed, ExitCode.SCAN_FAILED),
    (errors.ConfigError, ExitCode.USAGE),
    (errors.OutOfRange, ExitCode.USAGE),
    (errors.UnsupportedFeature, ExitCode.USAGE),
    (errors.DeviceError, ExitCode.DEVICE),
    (errors.CubeError, ExitCode.CUBE),
    (errors.CalibrationError, ExitCode.CUBE),
    (errors.ScanhsiError, ExitCode.SCAN_FAILED),
    (asyncio.CancelledError, ExitCode.INTERRUPTED),
    (KeyboardInterrupt, ExitCode.INTERRUPTED),
)


def exit_code_of(error: BaseException) -> ExitCode:
    """The exit code that an error ends a command with."""
    if isinstance(error, errors.ScanFailed) and error.unsafe:
        return ExitCode.UNSAFE
    return next((code for kind, code in _CODES if isinstance(error, kind)), ExitCode.INTERNAL)
