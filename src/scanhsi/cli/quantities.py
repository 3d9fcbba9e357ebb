"""Quantities with units as options."""

from __future__ import annotations

from datetime import timedelta
from typing import TYPE_CHECKING, Final

import typer

if TYPE_CHECKING:
    from scanhsi.calibration.applies import Limits

_AGES: Final = {"min": "minutes", "h": "hours", "d": "days"}


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


def limits_of(max_age: str | None, max_drift_c: float) -> Limits:
    """Limits for results that are used again: ``--max-age`` and ``--max-drift``.

    Args:
        max_age: As "12 h" or "3 d"; ``any`` for no limit; None: as usual for the kind of result.
        max_drift_c: How far temperatures may be apart.

    Raises:
        typer.BadParameter: It is no time.
    """
    from scanhsi.calibration.applies import Limits

    if max_age is None or max_age == "any":
        return Limits(None if max_age is None else timedelta.max, max_drift_c)
    number = max_age.rstrip("".join(_AGES) + " ")
    unit = max_age[len(number) :].strip()
    try:
        return Limits(timedelta(**{_AGES[unit]: float(number)}), max_drift_c)
    except (KeyError, ValueError, OverflowError) as error:
        raise typer.BadParameter(
            f"{max_age!r} is no age; write a number with one of the units {', '.join(_AGES)}, or any.",
            param_hint="--max-age",
        ) from error
