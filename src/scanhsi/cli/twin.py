"""``scanhsi twin``: a command of the simulator package, found by entry point."""

from __future__ import annotations

from importlib.metadata import entry_points
from typing import Annotated, Final

import typer

_GROUP: Final = "scanhsi.commands"


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(twin)


def twin(
    command: Annotated[
        list[str] | None,
        typer.Argument(metavar="COMMAND", help="After --: what to run beside the twins; a shell without it."),
    ] = None,
    scene: Annotated[
        str, typer.Option(help="What the camera twin looks at: testpattern, hand, white or dark.")
    ] = "testpattern",
    seed: Annotated[int, typer.Option(help="Seed of the scene and of the camera's noise.")] = 0,
) -> None:
    """Start twins of camera and stepper: something for the real drivers to talk to without hardware.

    They and the command run in a private network with nothing in it but loopback. The exit code is the command's.

    [bold]Example[/]: scanhsi twin -- scanhsi scan twin -o OUT
    """
    from scanhsi.devices.errors import ConfigError

    points = {point.name: point for point in entry_points(group=_GROUP)}
    if "twin" not in points:
        raise ConfigError(
            "the twins are not installed: no package offers the command 'twin'", hint="install scanhsi_sim."
        )
    run = points["twin"].load()
    raise typer.Exit(int(run(command or None, scene=scene, seed=seed)))
