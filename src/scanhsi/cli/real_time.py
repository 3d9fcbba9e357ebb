"""The option ``--real-time`` of commands that scan."""

from __future__ import annotations

from typing import Annotated

import typer

from scanhsi.clock import RealTime

RealTimeOption = Annotated[
    str | None,
    typer.Option(
        "--real-time",
        metavar="OPTIONS",
        help="Against lateness: gc (freeze what garbage collection would walk through), fifo (SCHED_FIFO for the event loop, where "
        "permitted), switch (threads change after 0.5 ms), with commas between; or all.",
    ),
]


def parsed_real_time(words: str | None, *, virtual: bool = False) -> RealTime:
    """The options; virtual time has no use for them."""
    if words is None:
        return RealTime()
    if virtual:
        raise typer.BadParameter("virtual time is never late; leave out one of the two.", param_hint="--real-time")
    try:
        return RealTime.of(words)
    except ValueError as error:
        raise typer.BadParameter(str(error), param_hint="--real-time") from error
