"""``scanhsi drain``, and the end of a scan through a spool."""

from __future__ import annotations

import time
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from scanhsi.cli.codes import ExitCode
from scanhsi.cli.output import messages, results, write_json

if TYPE_CHECKING:
    from scanhsi.cube.drain import Draining

_LINE_PERIOD_S = 5.0


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(drain)


def drain(
    spool: Annotated[Path, typer.Argument(help="Folder that was given to scan --spool.", metavar="SPOOL")],
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Send what waits in a spool to the object store: after a crash, a power cut, or a link that was down.

    [bold]Example[/]: scanhsi drain /var/spool/scanhsi
    """
    urls = drain_shown(spool)
    if json:
        write_json({"cubes": urls})
    elif urls:
        results().print(*(f"{url} is whole." for url in urls), sep="\n", soft_wrap=True)
    else:
        results().print(f"nothing waits in {spool}.", soft_wrap=True)


def drain_shown(spool: Path) -> list[str]:
    """Drain a spool, or wait until the scan's own thread has; Ctrl-C leaves the rest.

    Raises:
        CubeError: As `scanhsi.drain`.
    """
    from scanhsi.cube.drain import drain

    console = messages()
    status = console.status("draining the spool") if console.is_terminal else None
    due = time.monotonic() + _LINE_PERIOD_S

    def show(state: Draining) -> None:
        nonlocal due
        text = f"{state.url}: {state.waiting_bytes / 1e6:.1f} MB wait in the spool"
        if status is not None:
            status.update(f"{text}; Ctrl-C leaves them there")
        elif time.monotonic() > due:
            console.print(text, soft_wrap=True)
            due = time.monotonic() + _LINE_PERIOD_S

    try:
        with status or nullcontext():
            return drain(spool, progress=show)
    except KeyboardInterrupt:
        console.print(f"the rest stays in the spool, safe: scanhsi drain {spool}", soft_wrap=True)
        raise typer.Exit(ExitCode.INTERRUPTED) from None
