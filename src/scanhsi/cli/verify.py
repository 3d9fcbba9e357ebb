"""``scanhsi verify``."""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated, Any

import typer

from scanhsi.cli.codes import ExitCode
from scanhsi.cli.output import messages, results, write_json

if TYPE_CHECKING:
    from rich.console import Console

    from scanhsi.cube.verify import Verification

_MOST_PROBLEMS = 20


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(verify)


def verify(
    cube: Annotated[str, typer.Argument(help="Cube to check: a folder.")],
    repair: Annotated[
        bool, typer.Option("--repair", help="Remove what a crash left, and finish what it interrupted. Loses nothing.")
    ] = False,
    mark_unreadable: Annotated[
        bool,
        typer.Option(
            "--mark-unreadable", help="With --repair: lines that cannot be read become missing, with the reason."
        ),
    ] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="With --repair: tell what would be done.")] = False,
    threads: Annotated[int | None, typer.Option(min=1, help="Threads that read and decode.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> int:
    """Prove that every stored line of a cube is readable and intact. Changes nothing, unless told to --repair.

    Ends with exit code 4 if a line that the cube promises cannot be trusted.

    [bold]Example[/]: scanhsi verify hand.zarr
    """
    if (mark_unreadable or dry_run) and not repair:
        raise typer.BadParameter(
            "it says how to --repair, which is not asked for.", param_hint="--mark-unreadable, --dry-run"
        )
    from scanhsi.cube.repair import repair_cube
    from scanhsi.cube.verify import verify_cube

    steps: list[str] = []
    with _progress(messages()) as progress:
        if repair:
            found = repair_cube(
                cube,
                mark_unreadable=mark_unreadable,
                dry_run=dry_run,
                threads=threads,
                progress=progress,
                tell=steps.append,
            )
        else:
            found = verify_cube(cube, threads=threads, progress=progress)
    mended = mark_unreadable and not dry_run
    if json:
        write_json({**_described(found), "repair": {"done": not dry_run, "steps": steps} if repair else None})
    else:
        _show(results(), found, steps, repair=repair, dry_run=dry_run, mended=mended)
    return ExitCode.OK if found.intact or mended else ExitCode.CUBE


def _described(found: Verification) -> dict[str, Any]:
    return {
        "path": str(found.path),
        "intact": found.intact,
        "lines_reached": found.lines_reached,
        "lines_stored": found.lines_stored,
        "lines_missing": found.lines_missing,
        "bad_lines": list(found.bad_lines),
        "checksummed": found.checksummed,
        "untidy": found.untidy,
        "problems": [
            {"file": problem.file, "kind": problem.kind, "reason": problem.reason, "lines": list(problem.lines)}
            for problem in found.problems
        ],
        "leftovers": [
            {
                "path": str(leftover.path),
                "what": leftover.what,
                "size_bytes": leftover.size_bytes,
                "ours": leftover.ours,
            }
            for leftover in found.leftovers
        ],
        "notes": list(found.notes),
    }


def _show(
    console: Console, found: Verification, steps: list[str], *, repair: bool, dry_run: bool, mended: bool
) -> None:
    from rich.text import Text

    for problem in found.problems[:_MOST_PROBLEMS]:
        where = f" (lines {_ranges(problem.lines)})" if problem.lines else ""
        console.print(Text(f"{problem.file}: {problem.reason}{where}", style="red"), soft_wrap=True)
    if len(found.problems) > _MOST_PROBLEMS:
        console.print(Text(f"and {len(found.problems) - _MOST_PROBLEMS} more; --json tells all", style="red"))
    for note in found.notes:
        console.print(Text(note, style="dim"), soft_wrap=True)
    for leftover in found.leftovers if not repair else ():
        console.print(Text(f"left over: {leftover.path}: {leftover.what}", style="yellow"), soft_wrap=True)
    for step in steps:
        console.print(f"{'would ' if dry_run else ''}{step}", soft_wrap=True)
    console.print(_verdict(found, mended), soft_wrap=True)
    if (advice := _advice(found, repair)) is not None:
        console.print(Text.assemble(("try: ", "bold"), advice), soft_wrap=True)


def _verdict(found: Verification, mended: bool) -> Any:
    from rich.text import Text

    checked = f"{found.lines_stored} stored lines of {found.path}"
    if found.intact:
        return Text(f"{checked} are readable and intact", style="bold green")
    bad = len(found.bad_lines)
    if not bad:
        return Text(f"{checked} are readable, but the cube contradicts itself, see above", style="bold red")
    state = "could not be trusted and are marked now" if mended else "cannot be trusted"
    return Text(f"{bad} lines of {found.path} {state}: {_ranges(found.bad_lines)}", style="bold red")


def _advice(found: Verification, repair: bool) -> str | None:
    if repair:
        return None
    if not found.intact:
        return f"scanhsi verify {found.path} --repair --mark-unreadable, on a copy if it matters"
    if found.untidy or any(leftover.ours for leftover in found.leftovers):
        return f"scanhsi verify {found.path} --repair, to tidy up (nothing is lost by it)"
    return None


def _ranges(lines: tuple[int, ...]) -> str:
    from scanhsi.cube.repair import line_ranges

    return line_ranges(lines)


@contextmanager
def _progress(console: Console) -> Generator[Callable[[int, int], None] | None]:
    """A bar on a terminal; nothing elsewhere."""
    if not console.is_terminal:
        yield None
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        BarColumn(bar_width=None),
        TextColumn("{task.completed:.0f}/{task.total:.0f} files"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, transient=True) as bars:
        task = bars.add_task("", total=1)
        yield lambda done, total: bars.update(task, completed=done, total=total)
