"""Quantities with units as options."""

from __future__ import annotations

import typer


def seconds_of(text: str | None, option: str) -> float | None:
    """A time; None for none.

    Raises:
        typer.BadParameter: It is none, or has no unit.
    """
    if text is None:
        return None
    from pydantic import TypeAdapter, ValidationError

    from scanhsi.instrument.quantities import Seconds

    try:
        return TypeAdapter[float](Seconds).validate_python(text.strip())
    except ValidationError as error:
        raise typer.BadParameter(error.errors()[0]["msg"], param_hint=option) from error


def seconds_list(text: str | None, option: str) -> list[float] | None:
    """Times, separated by commas; None for none."""
    return (
        None if text is None else [time for part in text.split(",") if (time := seconds_of(part, option)) is not None]
    )
