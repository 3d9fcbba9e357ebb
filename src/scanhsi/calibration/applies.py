"""Whether a stored result still applies to what it is to be used on; if not, it is refused with the reason and the way out.

What matters differs: dark counts change with gain, format and warmth, where light falls does not. How old is too old is a matter of
the thing, too: a lamp changes in a day, a spectrograph in a year. Age counts from the result to the cube it is used on, either
way: old cubes may be processed with old references at any time.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Final

from scanhsi.calibration.conditions import Conditions
from scanhsi.calibration.kinds import is_result, load_any
from scanhsi.calibration.result import Result
from scanhsi.devices.errors import CalibrationError

_COUNTS: Final = ("gain_db", "pixel_format", "roi", "binning")
_PLACES: Final = ("roi", "binning")


@dataclass(frozen=True, slots=True)
class _Use:
    """How a kind of result is used.

    Attributes:
        name: In messages.
        shared: Conditions that must agree.
        max_age: Usual limit.
        warmth: Whether the temperature matters.
    """

    name: str
    shared: tuple[str, ...]
    max_age: timedelta
    warmth: bool


_USES: Final = {
    "dark": _Use("dark model", _COUNTS, timedelta(days=30), True),
    "white": _Use("white reference", _COUNTS, timedelta(days=1), False),
    "wavelength": _Use("wavelength calibration", _PLACES, timedelta(days=365), True),
    "smile": _Use("smile calibration", _PLACES, timedelta(days=365), True),
    "keystone": _Use("keystone calibration", _PLACES, timedelta(days=365), True),
    "geometry": _Use("geometry", _PLACES, timedelta(days=30), False),
}


@dataclass(frozen=True, slots=True)
class Limits:
    """How far a result may be from what it is used on.

    Attributes:
        max_age: Oldest (or youngest) that is good; None: as usual for its kind, a day for a white reference, 30 for a dark model
            or a geometry, a year for the spectrograph.
        max_drift_c: How far temperatures of the sensor may be apart.
    """

    max_age: timedelta | None = None
    max_drift_c: float = 5.0


USUAL: Final = Limits()


def check_applies(
    result: Result,
    conditions: Conditions,
    limits: Limits = USUAL,
    *,
    source: str | Path = "",
    region: bool = True,
) -> None:
    """Refuse a result that is not for these conditions.

    Args:
        result: Of any kind; those that are not used on cubes apply to all.
        conditions: Of the cube: `Conditions.of` its attributes. What is not known is not compared; without a time it is now.
        limits: Of age and temperature.
        source: File of the result, for the message.
        region: Whether the region has to be the same; of a geometry of which only distance and pitch are used it need not.

    Raises:
        CalibrationError: Gain, format, region, binning, age or temperature; says which, and what to do.
    """
    use = _USES.get(result.kind)
    if use is None:
        return
    provenance = result.provenance
    shared = tuple(name for name in use.shared if region or name != "roi")
    reasons = conditions.differences(provenance.conditions, exposure=False, only=shared)
    hints = [
        f"take a new {use.name} like this, or measure like the {use.name}" if reasons else f"take a new {use.name}"
    ]
    if (
        old := _too_old(provenance.taken, conditions.taken, use.max_age if limits.max_age is None else limits.max_age)
    ) is not None:
        reasons.append(old[0])
        hints.append(f"--max-age '{old[1]} d' to use it all the same")
    here, there = conditions.temperature_c, provenance.temperature_c
    if use.warmth and here is not None and there is not None and abs(here - there) > limits.max_drift_c:
        reasons.append(f"the sensor was at {there:.1f} degC and is at {here:.1f} degC")
        hints.append(f"--max-drift {math.ceil(abs(here - there))} to use it all the same")
    if reasons:
        name = f"{use.name} {source}" if source else use.name
        raise CalibrationError(f"the {name} does not apply: {'; '.join(reasons)}.", hint="; or ".join(hints))


def check_files(paths: Iterable[str | Path | None], cube: Mapping[str, Any], limits: Limits = USUAL) -> None:
    """Refuse stored results that are not for a cube: what a program calls with all that it was given, before it begins.

    Args:
        paths: Results, of any kind; None and what is no result, a cube say, are passed over.
        cube: Attributes of the cube.
        limits: Of age and temperature.

    Raises:
        CalibrationError: One does not apply, or cannot be read.
    """
    conditions = Conditions.of(cube)
    for path in paths:
        if path is not None and is_result(path):
            check_applies(load_any(path), conditions, limits, source=path)


def _too_old(taken: str | None, used: str | None, limit: timedelta) -> tuple[str, int] | None:
    """Why, and how many days would do."""
    if taken is None:
        return None
    then = datetime.fromisoformat(taken)
    now = datetime.now(UTC) if used is None else datetime.fromisoformat(used)
    apart = now - then
    if abs(apart) <= limit:
        return None
    way = "older" if apart > timedelta(0) else "younger"
    days = math.ceil(abs(apart) / timedelta(days=1))
    return f"it is {_span(abs(apart))} {way} than what it is used on, {_span(limit)} at most", days


def _span(time: timedelta) -> str:
    hours = time.total_seconds() / 3600
    if hours < 1:
        return f"{60 * hours:.3g} min"
    return f"{hours:.3g} h" if hours < 48 else f"{hours / 24:.4g} d"
