"""``scanhsi schema``."""

from __future__ import annotations

import json
import sys
from typing import Annotated

import typer


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(schema)


def schema(
    template: Annotated[
        bool, typer.Option("--template", help="Print a commented instrument file to start from instead.")
    ] = False,
) -> None:
    """Print the JSON schema of instrument files, with the options of the installed drivers.

    [bold]Example[/]: scanhsi schema --template > mine.toml
    """
    from scanhsi.instrument import template as commented
    from scanhsi.instrument.schema import schema as json_schema

    if template:
        sys.stdout.write(commented())
    else:
        sys.stdout.write(json.dumps(json_schema(), indent=2, ensure_ascii=False) + "\n")
