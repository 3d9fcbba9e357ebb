"""``scanhsi scan --resume``: what the command line says about a scan that is gone on with, and what it must not say."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from scanhsi.engine import ScanPlan
    from scanhsi.instrument import InstrumentConfig

ResumeOption = Annotated[
    str | None,
    typer.Option(
        "--resume",
        metavar="CUBE",
        help="Finish this cube, which was interrupted, taking only lines that it lacks. Its plan and, unless INSTRUMENT says so, "
        "its instrument are those it was begun with; what is not the same any more is told, and nothing done.",
    ),
]
OnFaultOption = Annotated[
    str | None,
    typer.Option(
        metavar="WHAT",
        help="skip (default): a lost frame costs its line, a lost device ends the scan; retry: lost frames are taken again, lost "
        "devices opened anew; abort: the first fault ends the scan.",
    ),
]
LineRetriesOption = Annotated[
    str | None, typer.Option(metavar="N", help="With retry: how often one line may be tried again.")
]
RetriesOption = Annotated[
    str | None, typer.Option(metavar="N", help="With retry: how often lines may be tried again in all.")
]
RecoverWithinOption = Annotated[
    str | None, typer.Option(metavar="TIME", help="With retry: time in which a lost device must be back.")
]


def begun_with(
    cube: str,
    instrument: str | None,
    settings: Mapping[str, object],
    recovery: Mapping[str, str],
) -> tuple[InstrumentConfig, ScanPlan]:
    """Instrument file and plan for going on with a cube.

    Args:
        cube: Path or URL.
        instrument: As for a new scan; None for that of the cube.
        settings: Keys of the instrument file to be set.
        recovery: What to do about faults, where that is said.
    """
    from scanhsi.cube.places import destination_of
    from scanhsi.engine.resume import begun
    from scanhsi.imager import default_plan
    from scanhsi.instrument import load_instrument

    before = begun(destination_of(cube))
    if settings and instrument is None:
        raise typer.BadParameter("the instrument file is that of the cube; name one to change it.", param_hint="--set")
    config = before.config if instrument is None else load_instrument(instrument, dict(settings))
    return config, default_plan(config, **{**before.plan.model_dump(mode="json"), **recovery})


def refuse_with_resume(given: Mapping[str, object]) -> None:
    """Refuse options that a cube that is gone on with has already decided.

    Raises:
        typer.BadParameter: Names the first.
    """
    for name, value in given.items():
        if value:
            option = f"--{name.removeprefix('storage.').replace('_', '-')}"
            raise typer.BadParameter("with --resume that is as it was when the cube was begun.", param_hint=option)
