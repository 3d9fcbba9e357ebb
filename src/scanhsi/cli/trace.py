"""``scanhsi trace``."""

from __future__ import annotations

from pathlib import Path, PurePosixPath
from typing import Annotated

import typer

from scanhsi.cli.output import messages, write_json


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(trace)


def trace(
    cube: Annotated[
        str, typer.Argument(help="Cube whose scan is to be traced: a folder, or a URL of an object store.")
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="JSON", help="Trace to write; replaced if it exists.")
    ],
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Write the trace of a scan for ui.perfetto.dev or chrome://tracing: one lane a stage, so that overlap is seen.

    [bold]Example[/]: scanhsi trace hand.zarr -o trace.json
    """
    from scanhsi.cube.reader import cube_summary, read_records
    from scanhsi.devices.errors import CubeError
    from scanhsi.timing.trace import write_trace

    summary, records = cube_summary(cube), read_records(cube)
    name = PurePosixPath(cube).name
    title = f"SIMULATED scan {name}" if summary.simulated else f"scan {name}"
    try:
        with output.open("w", encoding="utf-8") as file:
            spans = write_trace(records.stamps, file, title=title, missing=records.missing)
    except OSError as error:
        raise CubeError(f"cannot write {output}: {error.strerror or error}.") from error
    if json:
        write_json({"output": str(output), "spans": spans, "lines": records.lines, "simulated": summary.simulated})
    else:
        messages().print(
            f"{spans} spans of {records.lines} lines: open {output} in https://ui.perfetto.dev", soft_wrap=True
        )
