"""``scanhsi bench storage``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from scanhsi.cli.output import messages, results, write_json


def storage(
    output: Annotated[
        Path,
        typer.Option(
            "--output", "-o", metavar="DIR", help="Folder for observations (appended); its disk is what is measured."
        ),
    ],
    writers: Annotated[
        str | None, typer.Option(metavar="NAMES", help="As lz4,raw,tensorstore,floor; default: all that are installed.")
    ] = None,
    parts: Annotated[
        str, typer.Option(metavar="PARTS", help="Of flat out, paced, readers.")
    ] = "flat out,paced,readers",
    repetitions: Annotated[
        int, typer.Option(metavar="N", min=1, help="In which writers, and readers, take turns.")
    ] = 5,
    lines: Annotated[int, typer.Option(metavar="N", min=1, help="Of a cube that is written flat out.")] = 480,
    paced_lines: Annotated[
        int, typer.Option(metavar="N", min=1, help="Of a cube that is written as lines come.")
    ] = 448,
    read_lines: Annotated[int, typer.Option(metavar="N", min=1, help="Of the cube that is read.")] = 1200,
    rate: Annotated[float, typer.Option(metavar="LPS", min=0.1, help="Lines a second when paced.")] = 44.8,
    bands: Annotated[int, typer.Option(metavar="N", min=1)] = 1088,
    samples: Annotated[int, typer.Option(metavar="N", min=1)] = 1200,
    lines_per_shard: Annotated[int | None, typer.Option(metavar="N", min=1, help="[default: as a scan]")] = None,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Write and read cubes: ours, zarr-python, tensorstore, acquire-zarr, and the disk itself, side by side.

    At full size it takes about 25 minutes and 8 GB of disk. Peers that are not installed are left out, and named.

    [bold]Example[/]: scanhsi bench storage -o bench --writers lz4,raw,floor --repetitions 3
    """
    from scanhsi.bench.storage.report import markdown
    from scanhsi.bench.storage.rows import BY_KEY, ROWS
    from scanhsi.bench.storage.session import OBSERVATIONS, PARTS, Effort, run_session
    from scanhsi.bench.storage.work import Work

    chosen = [*BY_KEY] if writers is None else _words(writers, [*BY_KEY], "--writers")
    asked = _words(parts, list(PARTS), "--parts")
    effort = Effort(
        parts=[part for part in PARTS if part in asked],
        rows=[row for row in ROWS if row.key in chosen],
        flat_out=repetitions,
        paced=repetitions,
        reading=repetitions,
        work=Work(lines, bands, samples, lines_per_shard=lines_per_shard),
        rate=rate,
        paced_lines=paced_lines,
        reading_lines=read_lines,
    )
    records = run_session(effort, output, tell=messages().print)
    if json:
        write_json({"observations": str(output / OBSERVATIONS), "records": records})
        return
    results().print(markdown(records), markup=False, soft_wrap=True)
    messages().print(f"observations: {output / OBSERVATIONS}", soft_wrap=True)


def _words(text: str, known: list[str], option: str) -> list[str]:
    words = [word.strip() for word in text.split(",")]
    if unknown := [word for word in words if word not in known]:
        raise typer.BadParameter(f"{', '.join(unknown)}: there are {', '.join(known)}.", param_hint=option)
    return words
