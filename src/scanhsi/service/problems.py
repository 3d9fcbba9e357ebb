"""Errors as the service tells them: RFC 9457 problem details that carry the cause and the hint of the Python exceptions."""

from __future__ import annotations

import re
from typing import Any, Final, cast

from scanhsi.devices import errors
from scanhsi.devices.errors import ConfigError, ScanFailed, ScanhsiError
from scanhsi.service.refusals import Refused

MEDIA_TYPE: Final = "application/problem+json"

_STATUS: Final[tuple[tuple[type[BaseException], int], ...]] = (
    (errors.OutOfRange, 422),
    (errors.ConfigError, 422),
    (errors.UnsupportedFeature, 422),
    (errors.CalibrationError, 422),
    (errors.DeviceBusy, 409),
    (errors.PositionLost, 409),
    (errors.MotionFailed, 409),
    (errors.CubeExists, 409),
    (errors.NotACube, 404),
    (errors.CubeError, 422),
    (errors.ScanFailed, 409),
    (errors.DeviceTimeout, 504),
    (errors.DeviceError, 503),
)


def status_of(error: BaseException) -> int:
    """Status of the answer to a request that ends with an error."""
    if isinstance(error, Refused):
        return error.status
    return next((status for kind, status in _STATUS if isinstance(error, kind)), 500)


def problem_of(error: BaseException) -> dict[str, Any]:
    """An error as problem details, plain JSON types."""
    name = type(error).__name__ if isinstance(error, ScanhsiError) else "InternalError"
    problem: dict[str, Any] = {
        "type": f"/api/v1/problems/{name}",
        "title": re.sub(r"(?<!^)(?=[A-Z])", " ", name).capitalize(),
        "status": status_of(error),
        "detail": getattr(error, "message", None) or str(error) or name,
        "error": name,
    }
    if not isinstance(error, ScanhsiError):
        problem["detail"] = "this is a bug of scanhsi; the log of the service says more."
        return problem
    known = ("device", "operation", "line", "waited_s", "hint")
    problem |= {key: getattr(error, key) for key in known if getattr(error, key) is not None}
    if isinstance(error, ConfigError):
        problem["problems"] = list(error.problems)
    if isinstance(error, ScanFailed):
        problem |= {"stored": error.stored, "lines": error.lines, "lost": error.lost}
        problem["causes"] = [problem_of(cause) for cause in error.causes]
    elif isinstance(error.__cause__, ExceptionGroup):  # several devices failed at once
        group = cast("ExceptionGroup[Exception]", error.__cause__)
        problem["causes"] = [problem_of(cause) for cause in group.exceptions]
    elif isinstance(error.__cause__, ScanhsiError):
        problem["causes"] = [problem_of(error.__cause__)]
    return problem
