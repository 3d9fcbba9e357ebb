"""What a kind of calibration is to the command line, and the options that several kinds have."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

if TYPE_CHECKING:
    from scanhsi.calibration.applies import Limits
    from scanhsi.calibration.dark import DarkModel
    from scanhsi.calibration.geometry import Geometry, Turn
    from scanhsi.calibration.result import Result
    from scanhsi.characterise.calibrator import Calibrator

R = TypeVar("R", bound="Result")

Dark = Annotated[Path | None, typer.Option("--dark", help="Dark model of `scanhsi calibrate dark`.", dir_okay=False)]
Plane = Annotated[
    Path | None,
    typer.Option(help="Geometry as measured; default: as the instrument file has it.", dir_okay=False),
]
Frames = Annotated[int, typer.Option(min=2, help="Frames at each exposure.")]
Tile = Annotated[float, typer.Option(help="Reflectance of the white tile.")]
Exposure = Annotated[str | None, typer.Option(metavar="TIME", help='As "20 ms"; default: found automatically.')]
Exposures = Annotated[str | None, typer.Option(metavar="TIMES", help='As "10 ms, 100 ms".')]
Half = Annotated[float, typer.Option(help="How far the scan goes to both sides, mm.")]
Slant = Annotated[float, typer.Option(help="Of the lines from the slit, degrees.")]
Lines = Annotated[Path | None, typer.Option(help="CSV of the lamp's lines; default: mercury-argon.", dir_okay=False)]
Degree = Annotated[int, typer.Option(min=1, help="Of the polynomial.")]


@dataclass(frozen=True, slots=True)
class Given:
    """What a command was given besides its own options.

    Attributes:
        output: File of the result.
        cubes: Cubes that exist; None: an instrument takes them.
        limits: Of age and temperature, for results that were given.
    """

    output: Path
    cubes: list[str] | None
    limits: Limits

    def load(self, kind: type[R], path: Path | None, *, region: bool = True) -> R | None:
        """A result that was named, if it applies to the cubes; one for an instrument is looked at before it moves."""
        if path is None:
            return None
        from scanhsi.calibration.applies import check_applies
        from scanhsi.calibration.conditions import Conditions
        from scanhsi.calibration.result import load
        from scanhsi.cube.reader import open_cube

        result = load(kind, path)
        for cube in self.cubes or ():
            conditions = Conditions.of(open_cube(cube, chunks=None).attrs)
            check_applies(result, conditions, self.limits, source=path, region=region)
        return result

    def dark(self, path: Path | None) -> DarkModel | None:
        """A dark model that was named."""
        from scanhsi.calibration.dark import DarkModel

        return self.load(DarkModel, path)

    def plane(self, path: Path | None) -> Geometry | None:
        """A geometry that was named, for its distance and pitch."""
        from scanhsi.calibration.geometry import Geometry

        return self.load(Geometry, path, region=False)


@dataclass(frozen=True, slots=True)
class Work:
    """What a command does.

    Attributes:
        take: The protocol.
        work_out: The result of cubes that exist.
    """

    take: Callable[[Calibrator], Awaitable[Result]]
    work_out: Callable[[list[str]], Result]


Kind = Callable[..., Work]
"""A command: takes `Given` as ``given``, and options of its own; its name is that of the command."""


def only(cubes: list[Any], what: str) -> Any:
    """The one cube.

    Raises:
        typer.BadParameter: There are more, or none.
    """
    if len(cubes) != 1:
        raise typer.BadParameter(f"{what} is needed, one; there are {len(cubes)}.", param_hint="--from")
    return cubes[0]


def turn_of(text: str | None) -> Turn:
    """Steps of a turn, or ``find``.

    Raises:
        typer.BadParameter: Neither.
    """
    if text is None or text == "find":
        return text
    try:
        steps = float(text)
    except ValueError:
        steps = 0.0
    if steps <= 0:
        raise typer.BadParameter(f"{text!r} is no number of steps, and not 'find'.", param_hint="--turn")
    return steps
