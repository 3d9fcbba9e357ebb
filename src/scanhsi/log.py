"""Logging: events with context, through structlog, into Python's own `logging`.

Library code gets a logger with :func:`get_logger` and says what happens::

    log = get_logger(__name__)
    with structlog.contextvars.bound_contextvars(run=run, device=info.name, operation="connect"):
        log.info("connected", firmware=info.firmware)

It never configures anything: in somebody's own program warnings go where that program's logging sends them, with all context in
the text. The command line calls :func:`configure`. ``run``, ``device`` and ``operation`` are the context keys; nothing is logged
per line above DEBUG; values of keys that name a credential are masked, as are passwords in URLs.
"""

from __future__ import annotations

import json
import logging
import re
import sys
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final, cast

import structlog
from structlog.stdlib import BoundLogger, LoggerFactory, filter_by_level
from structlog.typing import EventDict, Processor, WrappedLogger

CONTEXT: Final = ("run", "device", "operation")
"""Keys that come first in every event, in this order."""

LEVELS: Final = ("debug", "info", "warning", "error")

_EVENT: Final = "scanhsi_event"
_SECRET: Final = re.compile(r"password|passwd|secret|token|credential|authorization|api_?key", re.IGNORECASE)
_URL_PASSWORD: Final = re.compile(r"(\w+://[^/\s:@]*):[^/\s@]+@")


def get_logger(name: str) -> BoundLogger:
    """A logger for a module: ``get_logger(__name__)``. Needs no configuration."""
    return cast(
        "BoundLogger",
        structlog.wrap_logger(
            logging.getLogger(name), processors=_PROCESSORS, wrapper_class=BoundLogger, cache_logger_on_first_use=True
        ),
    )


def configure(*, level: str = "info", as_json: bool = False, file: Path | None = None) -> None:
    """Send events to stderr, and to a file too. For programs, not for libraries; a second call replaces the first.

    Args:
        level: One of `LEVELS`; other people's loggers are heard from warning on.
        as_json: One JSON object a line on stderr instead of text.
        file: Appended to, one JSON object a line.

    Raises:
        OSError: The file cannot be opened.
    """
    handlers: list[logging.Handler] = [_StderrHandler()]
    handlers[0].setFormatter(_JsonFormatter() if as_json else _TextFormatter())
    if file is not None:
        handlers.append(logging.FileHandler(file, encoding="utf-8"))
        handlers[-1].setFormatter(_JsonFormatter())
    reset()
    root = logging.getLogger()
    for handler in handlers:
        handler.addFilter(_is_ours_or_serious)
        handler.set_name(_EVENT)
        root.addHandler(handler)
    root.setLevel(level.upper())
    # whoever logs through plain structlog is heard, too
    structlog.configure(processors=_PROCESSORS, wrapper_class=BoundLogger, logger_factory=LoggerFactory())


def stderr_is_json() -> bool:
    """Whether `configure` has made stderr a stream of JSON lines, so that nothing else may be written there."""
    handlers = logging.getLogger().handlers
    return any(
        isinstance(handler, _StderrHandler) and isinstance(handler.formatter, _JsonFormatter) for handler in handlers
    )


def reset() -> None:
    """Undo `configure`; closes its file."""
    root = logging.getLogger()
    for handler in [handler for handler in root.handlers if handler.get_name() == _EVENT]:
        root.removeHandler(handler)
        handler.close()
    root.setLevel(logging.WARNING)
    structlog.reset_defaults()


def _mask(logger: WrappedLogger, method: str, event: EventDict) -> EventDict:
    del logger, method
    return {
        key: "***" if _SECRET.search(key) else _URL_PASSWORD.sub(r"\1:***@", value) if isinstance(value, str) else value
        for key, value in event.items()
    }


def _hand_over(logger: WrappedLogger, method: str, event: EventDict) -> Mapping[str, Any]:
    """Arguments of the `logging` call: readable text for any handler, and the whole event for ours."""
    del logger, method
    passed = {key: event.pop(key) for key in ("exc_info", "stack_info") if key in event}
    ordered = {key: event[key] for key in ("event", *CONTEXT) if key in event} | dict(event)
    return {"msg": _text(ordered), "extra": {_EVENT: ordered}, **passed}


_PROCESSORS: Final[list[Processor]] = [
    filter_by_level,
    structlog.contextvars.merge_contextvars,
    _mask,
    _hand_over,
]


def _text(event: Mapping[str, Any]) -> str:
    pairs = [
        f"{key}={value!r}" if isinstance(value, str) else f"{key}={value}"
        for key, value in event.items()
        if key != "event"
    ]
    return " ".join([str(event.get("event", "")), *pairs])


def _is_ours_or_serious(record: logging.LogRecord) -> bool:
    return hasattr(record, _EVENT) or record.levelno >= logging.WARNING


class _StderrHandler(logging.Handler):
    """Writes to whatever ``sys.stderr`` is at the time, so that lines appear above a live progress bar."""

    def emit(self, record: logging.LogRecord) -> None:
        try:
            sys.stderr.write(self.format(record) + "\n")
        except Exception:  # as logging's own handlers do: a log that cannot be written stops nothing
            self.handleError(record)


class _TextFormatter(logging.Formatter):
    def __init__(self) -> None:
        super().__init__("%(asctime)s.%(msecs)03d %(levelname)-7s %(message)s", datefmt="%H:%M:%S")


def as_json(record: logging.LogRecord) -> dict[str, Any]:
    """An event with its context, plain JSON types."""
    event: dict[str, Any] = getattr(record, _EVENT, {"event": record.getMessage()})
    whole = {
        "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="microseconds"),
        "level": record.levelname.lower(),
        "logger": record.name,
        **event,
    }
    return cast("dict[str, Any]", json.loads(json.dumps(whole, default=str)))


class _JsonFormatter(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        whole = as_json(record)
        if record.exc_info:
            whole["exception"] = self.formatException(record.exc_info)
        return json.dumps(whole, default=str, ensure_ascii=False)
