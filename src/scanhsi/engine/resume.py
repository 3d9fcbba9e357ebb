"""Going on with an interrupted scan in another session: what it was begun with, and whether that is still so."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final, cast

from pydantic import ValidationError

from scanhsi.cube.destination import Destination
from scanhsi.cube.metadata import ROOT, decoded
from scanhsi.cube.shards import disk_error
from scanhsi.devices.errors import ConfigError, CubeError, NotACube
from scanhsi.engine.plan import ScanPlan
from scanhsi.instrument import InstrumentConfig
from scanhsi.instrument.problems import problems_of

_MAY_DIFFER: Final = frozenset({"name", "description", "scan", "limits"})
"""Of an instrument file: what says nothing of the lines."""
_HOW: Final = frozenset({"on_fault", "line_retries", "retries", "recover_within_s"})
"""Of a plan: what says nothing of the lines."""
_IDENTITY: Final = ("driver", "vendor", "model", "serial", "firmware", "steps_per_revolution", "simulated", "scene")


@dataclass(frozen=True, slots=True)
class Begun:
    """What an interrupted cube was begun with.

    Attributes:
        name: Path or URL of the cube.
        attributes: Of the cube.
        config: The instrument file.
        plan: What was being scanned.
    """

    name: str
    attributes: Mapping[str, Any]
    config: InstrumentConfig
    plan: ScanPlan

    @property
    def of_the_scan(self) -> dict[str, Any]:
        """What the cube says of itself whichever session writes it."""
        names = ("plan", "instrument", "simulated", "target")
        return {name: self.attributes[name] for name in names if name in self.attributes}

    def differences(self, config: InstrumentConfig, plan: ScanPlan, devices: Mapping[str, Any]) -> list[str]:
        """What is not as it was when the cube was begun: one sentence each, none where the scan may go on.

        Args:
            config: The instrument file now.
            plan: The plan now.
            devices: What the instrument is now, as `Instrument.describe` tells.
        """
        written = ("plan", self.plan.model_dump(mode="json"), plan.model_dump(mode="json"), _HOW)
        file = ("instrument", self.attributes["instrument"], config.model_dump(mode="json"), _MAY_DIFFER)
        problems = [problem for name, then, now, but in (written, file) for problem in _differing(name, then, now, but)]
        there = self.attributes.get("devices", {})
        for role in ("camera", "actuator", "light"):
            then, now = _identity(there.get(role, {})), _identity(devices.get(role, {}))
            problems += _differing(f"device {role}", then, now)
        return problems


def begun(place: Destination) -> Begun:
    """Read what a cube was begun with.

    Raises:
        NotACube: There is none.
        CubeError: It is complete, or was not made by a scan, or cannot be read.
        ConfigError: This scanhsi, or this computer, does not know that instrument or plan any more.
    """
    try:
        root = place.get(ROOT)
    except NotADirectoryError:
        root = None
    except OSError as error:
        raise disk_error(place, error, needed=0) from error
    if root is None:
        raise NotACube(f"there is no cube at {place.name}.")
    try:
        attributes = cast("dict[str, Any]", decoded(root)[ROOT]["attributes"])
    except (ValueError, KeyError, TypeError) as error:
        raise NotACube(f"{place.name} was not written by scanhsi, or its {ROOT} is damaged.") from error
    if attributes.get("complete"):
        raise CubeError(f"{place.name} is complete: there is nothing to resume.")
    if not isinstance(attributes.get("plan"), dict) or not isinstance(attributes.get("instrument"), dict):
        raise CubeError(f"{place.name} does not tell what scan it is of: it cannot be resumed.")
    try:
        plan = ScanPlan.model_validate(_written(attributes["plan"]))
    except ValidationError as error:
        raise ConfigError(f"the plan of {place.name} is not understood:", problems_of(error, ScanPlan)) from error
    try:
        config = InstrumentConfig.model_validate(_written(attributes["instrument"]))
    except ValidationError as error:
        problems = problems_of(error, InstrumentConfig)
        raise ConfigError(f"the instrument of {place.name} is not understood:", problems) from error
    return Begun(place.name, attributes, config, plan)


def _written(table: Mapping[str, Any]) -> dict[str, Any]:
    """A table as a person would have written it: without what was left out."""
    return {
        key: _written(cast("Mapping[str, Any]", value)) if isinstance(value, Mapping) else value
        for key, value in table.items()
        if value is not None
    }


def _identity(device: Mapping[str, Any]) -> dict[str, Any]:
    return {name: device[name] for name in _IDENTITY if name in device}


def _differing(
    where: str, then: Mapping[str, Any], now: Mapping[str, Any], but: frozenset[str] = frozenset()
) -> Iterator[str]:
    """Keys whose values differ, in tables within tables; a key that is absent is one without a value."""
    for key in sorted((then.keys() | now.keys()) - but):
        before, after = then.get(key), now.get(key)
        if any(isinstance(value, Mapping) for value in (before, after)):
            yield from _differing(f"{where}.{key}", _table(before), _table(after))
        elif before != after:
            yield f"{where}.{key}: {_told(before)} when the cube was begun, {_told(after)} now"


def _table(value: object) -> Mapping[str, Any]:
    return cast("Mapping[str, Any]", value) if isinstance(value, Mapping) else {}


def _told(value: object) -> str:
    return "nothing" if value is None else repr(value)
