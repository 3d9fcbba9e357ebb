"""From problem details back to the exceptions that they were."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

from scanhsi.devices import errors
from scanhsi.devices.errors import ConfigError, DeviceBusy, ScanFailed, ScanhsiError

_HERE = {"NotInControl": DeviceBusy, "LeaseHeld": DeviceBusy, "InvalidRequest": ConfigError}
"""What a service refuses has its nearest relative in the tree."""


def error_of(problem: Mapping[str, Any]) -> ScanhsiError:
    """The exception that a problem tells of, with its causes as causes."""
    name, detail = str(problem.get("error", "")), str(problem.get("detail", problem))
    causes = [error_of(cause) for cause in cast("list[dict[str, Any]]", problem.get("causes") or [])]
    if name == "ScanFailed" and causes:
        stored, lines = int(problem.get("stored", 0)), int(problem.get("lines", 0))
        return ScanFailed(causes, stored=stored, lines=lines, lost=problem.get("lost"))
    if name in ("ConfigError", "InvalidRequest"):
        sentences = cast("list[str]", problem.get("problems") or [])
        error: ScanhsiError = ConfigError(detail.split("\n")[0], sentences, hint=problem.get("hint"))
    else:
        kind = getattr(errors, name, None) or _HERE.get(name, ScanhsiError)
        known = ("device", "operation", "line", "waited_s", "hint")
        error = kind(detail, **{key: problem[key] for key in known if problem.get(key) is not None})
    error.__cause__ = causes[0] if causes else None
    return error
