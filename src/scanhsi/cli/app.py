"""The program: options of all commands, the commands, and how it ends."""

from __future__ import annotations

import asyncio
import contextlib
import inspect
import logging
import os
import signal
import sys
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, Protocol, runtime_checkable

import typer
from typer.core import TyperGroup
from typer.rich_utils import rich_format_error

from scanhsi import log
from scanhsi.cli import (
    bench,
    calibrate,
    delays,
    drain,
    drivers,
    export,
    figures,
    importing,
    info,
    plan,
    predict,
    process,
    scan,
    schema,
    serve,
    spec,
    trace,
    twin,
    verify,
    view,
)
from scanhsi.cli.codes import EXIT_CODES, ExitCode
from scanhsi.cli.output import show_error, write_json

EXIT_S = 5.0
"""How long a program that is done waits for its threads."""

_FLAGS = ("--log-json", "--version")
_WITH_VALUE = ("--log-level", "--log-file")


def global_options_first(args: Sequence[str]) -> list[str]:
    """The same words with the options of all commands in front, so that they may stand anywhere before ``--``."""
    end = list(args).index("--") if "--" in args else len(args)
    first: list[str] = []
    rest: list[str] = []
    words = iter(args[:end])
    for word in words:
        if word in _WITH_VALUE:
            first += [word, *[value for value in [next(words, None)] if value is not None]]
        elif word in _FLAGS or word.split("=", 1)[0] in _WITH_VALUE:
            first.append(word)
        else:
            rest.append(word)
    return [*first, *rest, *args[end:]]


class _Group(TyperGroup):
    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        return super().parse_args(ctx, global_options_first(args))


app = typer.Typer(
    name="scanhsi",
    cls=_Group,
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    epilog=f"[bold]Exit codes[/]: {EXIT_CODES}.",
)
for _command in (
    scan,
    info,
    view,
    process,
    export,
    importing,
    plan,
    predict,
    delays,
    drain,
    drivers,
    schema,
    serve,
    calibrate,
    spec,
    figures,
    trace,
    bench,
    twin,
    verify,
):
    _command.register(app)


def _unwrap(commands: typer.Typer) -> None:
    """Join the lines of each paragraph of help: typer keeps those of docstrings, whatever the width of the terminal."""
    for command in commands.registered_commands:
        text = command.help or inspect.getdoc(command.callback) or ""
        command.help = "\n\n".join(" ".join(paragraph.split()) for paragraph in text.split("\n\n"))
    for group in commands.registered_groups:
        if group.typer_instance is not None:
            _unwrap(group.typer_instance)


_unwrap(app)


def _version(asked: bool) -> None:
    if asked:
        from importlib.metadata import version

        sys.stdout.write(f"scanhsi {version('scanhsi')}\n")
        raise typer.Exit


@app.callback()
def _common(
    log_level: Annotated[
        Literal["debug", "info", "warning", "error"],
        typer.Option(help="Least level of events on stderr; debug also shows the traceback of errors."),
    ] = "info",
    log_json: Annotated[bool, typer.Option("--log-json", help="Events on stderr as JSON, one a line.")] = False,
    log_file: Annotated[
        Path | None, typer.Option(help="Append events to this file as JSON, one a line.", dir_okay=False)
    ] = None,
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    """Scan with line-scanning hyperspectral imagers: real ones, or simulated.

    [bold]Example[/]: scanhsi scan sensors2019 -o hand.zarr
    """
    del version
    try:
        log.configure(level=log_level, as_json=log_json, file=log_file)
    except OSError as error:
        raise typer.BadParameter(f"{log_file} cannot be written: {error.strerror}", param_hint="--log-file") from error


def run(args: Sequence[str]) -> int:
    """Run a command line (without the program's name); return its exit code."""
    as_json = "--json" in (args[: list(args).index("--")] if "--" in args else args)
    try:
        code = app(list(args), prog_name="scanhsi", standalone_mode=False)
        return code if isinstance(code, int) else ExitCode.OK
    except BrokenPipeError:  # whoever read stdout has enough
        sys.stderr.close()
        return ExitCode.OK
    except (Exception, KeyboardInterrupt, asyncio.CancelledError) as error:
        if isinstance(error, _UsageError):
            return _show_usage_error(error, as_json)
        return show_error(error, as_json=as_json, debug=logging.getLogger().isEnabledFor(logging.DEBUG))
    finally:
        log.reset()


def main() -> None:
    """Entry point of the console script ``scanhsi``."""
    try:
        code = run(sys.argv[1:])
    except KeyboardInterrupt:  # while the end was told
        code = ExitCode.INTERRUPTED
    # all is done: the exit code says how it ended, not that Python was leaving
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with contextlib.suppress(OSError):  # nobody reads it any more
        sys.stdout.flush()
    # a thread that waits for a dead disk would keep the process
    last_resort = threading.Timer(EXIT_S, os._exit, (code,))
    last_resort.daemon = True
    last_resort.start()
    sys.exit(code)


@runtime_checkable
class _UsageError(Protocol):
    """typer's error for a wrong command line; where its class lives differs between versions of typer."""

    exit_code: int

    def format_message(self) -> str: ...


def _show_usage_error(error: _UsageError, as_json: bool) -> int:
    if as_json:
        message = {"type": "UsageError", "message": error.format_message(), "exit_code": int(ExitCode.USAGE)}
        write_json({"error": message})
    rich_format_error(error)  # pyright: ignore[reportArgumentType] it is typer's own error
    return ExitCode.USAGE
