"""``scanhsi bench processing``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from scanhsi.cli.output import messages, results, write_json

_PEERS = Path(".venv-peers/bin/python")


def processing(
    output: Annotated[
        Path,
        typer.Option(
            "--output", "-o", metavar="DIR", help="Folder for observations (appended); its disk is what is measured."
        ),
    ],
    parts: Annotated[str, typer.Option(metavar="PARTS", help="Of memory, disk, live.")] = "memory,disk,live",
    repetitions: Annotated[int, typer.Option(metavar="N", min=1, help="In which the rows take turns.")] = 3,
    lines: Annotated[int, typer.Option(metavar="N", min=1, help="Of the raw cube.")] = 1200,
    live_lines: Annotated[
        int, typer.Option(metavar="N", min=1, help="Of the cube that is scanned at full rate.")
    ] = 1200,
    bands: Annotated[int, typer.Option(metavar="N", min=10)] = 1088,
    samples: Annotated[int, typer.Option(metavar="N", min=10)] = 1200,
    openhsi: Annotated[
        Path | None,
        typer.Option(metavar="PYTHON", help="Of an environment that has openhsi.", show_default=f"{_PEERS}, if there"),
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Raw counts to reflectance at full size: in memory, from disk to disk, beside a scan; beside a copy and OpenHSI.

    At full size it takes some minutes and 9 GB of disk.

    [bold]Example[/]: scanhsi bench processing -o bench --lines 300 --repetitions 2
    """
    from scanhsi.bench.processing.report import markdown
    from scanhsi.bench.processing.session import OBSERVATIONS, PARTS, Effort, run_session
    from scanhsi.bench.processing.work import Size

    asked = [word.strip() for word in parts.split(",")]
    if unknown := [word for word in asked if word not in PARTS]:
        raise typer.BadParameter(f"{', '.join(unknown)}: there are {', '.join(PARTS)}.", param_hint="--parts")
    effort = Effort(
        parts=[part for part in PARTS if part in asked],
        size=Size(lines, bands, samples),
        live_lines=live_lines,
        repetitions=repetitions,
        openhsi=openhsi or (_PEERS if _PEERS.exists() else None),
    )
    records = run_session(effort, output, tell=messages().print)
    if json:
        write_json({"observations": str(output / OBSERVATIONS), "records": records})
        return
    results().print(markdown(records), markup=False, soft_wrap=True)
    messages().print(f"observations: {output / OBSERVATIONS}", soft_wrap=True)
