"""``scanhsi drivers``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from scanhsi.cli.output import results, write_json

if TYPE_CHECKING:
    from scanhsi.devices import Found


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(drivers)


def drivers(
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """List the installed drivers, what each can do, and what is missing to use it.

    [bold]Example[/]: scanhsi drivers
    """
    from scanhsi.devices import Role, installed

    found = {role: installed(role) for role in Role}
    if json:
        write_json({f"{role.word}s": [_described(driver) for driver in drivers] for role, drivers in found.items()})
    else:
        _show([(role.word, driver) for role, drivers in found.items() for driver in drivers])


def _described(found: Found) -> dict[str, Any]:
    backend = found.backend
    return {
        "name": found.name,
        "package": found.package,
        "summary": backend.summary if backend else None,
        "capabilities": list(backend.capabilities) if backend else [],
        "virtual_time": backend.virtual_time if backend else False,
        "usable": found.problem is None,
        "problem": found.problem,
    }


def _show(rows: list[tuple[str, Found]]) -> None:
    from rich import box
    from rich.table import Table
    from rich.text import Text

    table = Table("role", "driver", "what it drives", "abilities", "usable here", box=box.SIMPLE_HEAD, pad_edge=False)
    for role, found in rows:
        usable = Text("yes", style="green") if found.problem is None else Text(f"no: {found.problem}", style="red")
        backend = found.backend
        abilities = ", ".join(backend.capabilities) if backend else ""
        table.add_row(role, Text(found.name, style="bold"), backend.summary if backend else "", abilities, usable)
    results().print(table)
