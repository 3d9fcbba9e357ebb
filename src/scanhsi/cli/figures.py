"""``scanhsi figures``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from scanhsi.cli.output import messages, results, write_json

if TYPE_CHECKING:
    from scanhsi.bench.paper import Made


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(figures)


def figures(
    found: Annotated[
        list[Path],
        typer.Argument(
            metavar="RESULT", help="Folders, or files: results (*.nc) with their cubes, records of the bench."
        ),
    ],
    output: Annotated[Path, typer.Option("--output", "-o", metavar="DIR", help="Folder of the figures.")] = Path(
        "figures"
    ),
    cube: Annotated[str | None, typer.Option(help="Cube for figure 14, best of reflectance.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Draw every figure of the paper's results from your own data, as PNG and PDF, and say which cannot be drawn, and why.

    Of several results of a kind the youngest is drawn.

    [bold]Example[/]: scanhsi figures results/ --cube hand.zarr -o figures
    """
    from scanhsi.bench.findings import look_through
    from scanhsi.bench.paper import draw_paper
    from scanhsi.devices.errors import CalibrationError

    made: list[Made] = []
    for one in draw_paper(look_through(found), output, cube=cube):
        made.append(one)
        if json:
            continue
        head = f"figure {one.figure:2}  {one.title}"
        if one.files:
            lacks = f" (without {one.lacks})" if one.lacks else ""
            results().print(f"{head}: {one.files[0]}{lacks}", soft_wrap=True, highlight=False)
        else:
            results().print(f"{head}: not drawn, {one.lacks}", style="yellow", soft_wrap=True, highlight=False)
    if json:
        write_json(
            {
                "figures": [
                    {"figure": one.figure, "title": one.title, "files": [str(f) for f in one.files], "lacks": one.lacks}
                    for one in made
                ]
            }
        )
    drawn = sum(bool(one.files) for one in made)
    if not drawn:
        raise CalibrationError(f"none of the {len(made)} figures could be drawn.")
    messages().print(f"{drawn} of {len(made)} figures in {output}", soft_wrap=True)
