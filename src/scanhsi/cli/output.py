"""What commands say, and where: results on stdout, everything else on stderr; with ``--json`` one object on stdout."""

from __future__ import annotations

import io
import json
import math
import sys
import traceback
from typing import Any, cast

from rich.console import Console
from rich.text import Text

from scanhsi import log
from scanhsi.cli.codes import ExitCode, exit_code_of
from scanhsi.devices.errors import ConfigError, ScanFailed, ScanhsiError

_log = log.get_logger(__name__)


def results() -> Console:
    """Console of results: stdout."""
    return Console(highlight=False)


def messages() -> Console:
    """Console of progress and messages: stderr, as events where that has to be JSON."""
    if log.stderr_is_json():
        return Console(file=_Events(), highlight=False, soft_wrap=True)
    return Console(stderr=True, highlight=False)


class _Events(io.StringIO):
    """Turns each line written into an event."""

    def write(self, text: str, /) -> int:
        for line in text.splitlines():
            if line.strip():
                _log.info(line.strip())
        return len(text)


def write_json(value: dict[str, Any]) -> None:
    """Write the one JSON object of a command; numbers that JSON lacks (nan, inf) become null."""
    sys.stdout.write(json.dumps(_finite(value), ensure_ascii=False) + "\n")


def show_error(error: BaseException, *, as_json: bool, debug: bool) -> ExitCode:
    """Tell an error: a red sentence with what to try on stderr, with ``--json`` an object on stdout too.

    The traceback is shown for bugs, and for everything when debugging.
    """
    code = exit_code_of(error)
    if as_json:
        write_json({"error": describe_error(error)})
    if log.stderr_is_json():
        _log.error("failed", exc_info=error if debug or code is ExitCode.INTERNAL else None, **describe_error(error))
        return code
    console = messages()
    if debug or code is ExitCode.INTERNAL:
        console.print(Text("".join(traceback.format_exception(error)).rstrip(), style="dim"))
    if code is ExitCode.INTERRUPTED:
        console.print(Text("interrupted.", style="bold yellow"))
        return code
    sentence, hint = _sentence(error)
    console.print(Text.assemble(("error: ", "bold red"), (sentence, "red")), soft_wrap=True)
    if hint:
        console.print(Text.assemble(("try: ", "bold"), hint), soft_wrap=True)
    if isinstance(error, ScanFailed):
        for unsafe in error.unsafe:
            console.print(
                Text(f"{unsafe.message} ({unsafe.device}): {unsafe.hint}", style="bold white on red"), soft_wrap=True
            )
    return code


def describe_error(error: BaseException) -> dict[str, Any]:
    """An error as plain JSON types: ``type``, ``message``, ``exit_code``, and what is known beyond that."""
    described: dict[str, Any] = {
        "type": "Interrupted" if exit_code_of(error) is ExitCode.INTERRUPTED else type(error).__name__,
        "message": getattr(error, "message", None) or str(error),
        "exit_code": int(exit_code_of(error)),
    }
    if isinstance(error, ScanhsiError):
        known = ("device", "operation", "line", "waited_s", "hint")
        described |= {name: getattr(error, name) for name in known if getattr(error, name) is not None}
    if isinstance(error, ConfigError):
        described["problems"] = list(error.problems)
    if isinstance(error, ScanFailed):
        described |= {"stored": error.stored, "lines": error.lines, "output": error.output}
        described["unsafe"] = [str(device.device) for device in error.unsafe]
        described["causes"] = [describe_error(cause) for cause in error.causes]
    elif isinstance(error.__cause__, ExceptionGroup):  # several devices failed at once
        group = cast("ExceptionGroup[Exception]", error.__cause__)
        described["causes"] = [describe_error(cause) for cause in group.exceptions]
    return described


def _sentence(error: BaseException) -> tuple[str, str | None]:
    """What happened, and what to try."""
    if not isinstance(error, ScanhsiError):
        return f"{type(error).__name__}: {error}", "report this as a bug of scanhsi, with the lines above."
    text = str(error)
    return (text.removesuffix(f" Try: {error.hint}"), error.hint) if error.hint else (text, None)


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in cast("dict[str, Any]", value).items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in cast("list[Any]", value)]
    return None if isinstance(value, float) and not math.isfinite(value) else value
