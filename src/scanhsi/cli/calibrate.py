"""``scanhsi calibrate``: one command a kind, each with options of its own and those that all have."""

from __future__ import annotations

import inspect
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import typer

from scanhsi.cli.calibrate_run import Job, run_job
from scanhsi.cli.calibrations import KINDS
from scanhsi.cli.calibrations.work import Given, Kind
from scanhsi.cli.quantities import limits_of

_REUSE = "Results that are given"
_ALL = "As with all calibrations"


def register(app: typer.Typer) -> None:
    """Add the commands."""
    group = typer.Typer(no_args_is_help=True, help="Characterise an instrument: take, work out, draw and keep.")
    for kind in KINDS:
        group.command(kind.__name__.replace("_", "-"))(_command(kind))
    app.add_typer(group, name="calibrate")


def _all_kinds(
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="FILE", help="Result, a NetCDF-4 file, conventionally *.nc.")
    ],
    instrument: Annotated[
        str | None,
        typer.Argument(
            help="Name of a shipped instrument (sensors2019, characterise, twin), or path of an instrument file; not with --from."
        ),
    ] = None,
    cubes: Annotated[
        list[str] | None,
        typer.Option(
            "--from", metavar="CUBE", help="Use cubes that exist, not the instrument; repeatable.", rich_help_panel=_ALL
        ),
    ] = None,
    figure: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Figure, .png or .pdf; default: beside the result.", rich_help_panel=_ALL),
    ] = None,
    no_figure: Annotated[bool, typer.Option("--no-figure", help="Draw none.", rich_help_panel=_ALL)] = False,
    virtual: Annotated[
        bool, typer.Option("--virtual", help="Simulated instruments: in virtual time.", rich_help_panel=_ALL)
    ] = False,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="KEY=VALUE", help="Set a key of the instrument file; repeatable.", rich_help_panel=_ALL
        ),
    ] = None,
    yes: Annotated[
        bool, typer.Option("--yes", "-y", help="Do not ask: everything is where it should be.", rich_help_panel=_ALL)
    ] = False,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object.", rich_help_panel=_ALL)] = False,
    max_age: Annotated[
        str | None,
        typer.Option(
            metavar="TIME",
            help='Oldest good result, as "12 h"; default: by its kind, 30 days for a dark model.',
            rich_help_panel=_REUSE,
        ),
    ] = None,
    max_drift: Annotated[
        float, typer.Option(help="How far sensor temperatures may be apart, K.", rich_help_panel=_REUSE)
    ] = 5.0,
) -> tuple[Job, Given]:
    """The job without its work, and what kinds are told of it."""
    job = Job(instrument, output, cubes, settings, virtual, yes, figure, no_figure, json, limits_of(max_age, max_drift))
    return job, Given(output, cubes, job.limits)


def _command(kind: Kind) -> Any:
    """A kind as typer has it: a function whose parameters are those of the kind and those of all."""
    own = _parameters(kind)
    of_all = _parameters(_all_kinds)

    @wraps(kind)
    def command(**values: Any) -> None:
        job, given = _all_kinds(**{name: values.pop(name) for name in of_all})
        run_job(job, lambda: kind(given, **values))

    both = [*own.values(), *of_all.values()]
    required = [parameter for parameter in both if parameter.default is parameter.empty]
    optional = [parameter for parameter in both if parameter.default is not parameter.empty]
    command.__signature__ = inspect.Signature([*required, *optional])  # pyright: ignore[reportAttributeAccessIssue] typer reads it
    command.__annotations__ = {parameter.name: parameter.annotation for parameter in both}
    return command


def _parameters(function: Any) -> dict[str, inspect.Parameter]:
    """Its options, their types resolved."""
    hints = get_type_hints(function, include_extras=True)
    signature = inspect.signature(function)
    return {
        name: parameter.replace(annotation=hints[name], kind=inspect.Parameter.KEYWORD_ONLY)
        for name, parameter in signature.parameters.items()
        if name != "given"
    }
