"""Reading instrument files, shipped or one's own."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any, Final, cast

from pydantic import ValidationError

from scanhsi.devices.errors import ConfigError
from scanhsi.instrument.config import InstrumentConfig
from scanhsi.instrument.problems import nearest, problems_of

_SHIPPED: Final = files("scanhsi.instrument") / "instruments"
_TEMPLATE: Final = "template.toml"


def shipped() -> list[str]:
    """Names of the instruments that come with scanhsi."""
    names = (item.name for item in _SHIPPED.iterdir())
    return sorted(name.removesuffix(".toml") for name in names if name.endswith(".toml") and name != _TEMPLATE)


def template() -> str:
    """The commented instrument file to start from."""
    return (_SHIPPED / _TEMPLATE).read_text(encoding="utf-8")


def load_instrument(source: str | Path, overrides: Mapping[str, object] | None = None) -> InstrumentConfig:
    """Read and check an instrument file.

    Args:
        source: Name of a shipped instrument, or path of a file (a `Path`, or text that ends in ``.toml`` or has a slash in it).
        overrides: Dotted key -> value, put over what the file says: ``{"geometry.distance": "300 mm"}``.

    Raises:
        ConfigError: There is no such instrument, the file cannot be read, or it is wrong; lists all its problems.
        DeviceUnavailable: A driver is installed and cannot be loaded on this computer.
    """
    place = _locate(source)
    table = _parse(place)
    table.setdefault("name", place.name.removesuffix(".toml"))
    for key, value in (overrides or {}).items():
        _put(table, key, value)
    try:
        return InstrumentConfig.model_validate(table)
    except ValidationError as error:
        problems = problems_of(error, InstrumentConfig)
        count = "1 problem" if len(problems) == 1 else f"{len(problems)} problems"
        changed = f" with {', '.join(overrides)} set otherwise" if overrides else ""
        raise ConfigError(
            f"instrument file {place}{changed} has {count}:",
            problems,
            hint="`scanhsi schema` describes every key, `scanhsi schema --template` is a commented file.",
        ) from error


def _locate(source: str | Path) -> Traversable:
    if isinstance(source, Path) or source.endswith(".toml") or "/" in source:
        return Path(source)
    names = shipped()
    if source in names:
        return _SHIPPED / f"{source}.toml"
    guess = nearest(source, names)
    raise ConfigError(
        f"there is no instrument {source!r}{f'; did you mean {guess}?' if guess else ''}",
        hint=f"one of the shipped instruments ({', '.join(names)}), or the path of an instrument file (./{source}.toml).",
    )


def _parse(place: Traversable) -> dict[str, Any]:
    try:
        return tomllib.loads(place.read_text(encoding="utf-8"))
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"instrument file {place} is not valid TOML: {error}") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"instrument file {place} is not UTF-8 text (byte {error.start})") from error
    except OSError as error:
        raise ConfigError(
            f"instrument file {place} cannot be read: {error.strerror}",
            hint=f"a path that exists, or one of the shipped instruments: {', '.join(shipped())}.",
        ) from error


def _put(table: dict[str, Any], key: str, value: object) -> None:
    *tables, last = key.split(".")
    for depth, name in enumerate(tables, 1):
        inner = table.setdefault(name, {})
        if not isinstance(inner, dict):
            raise ConfigError(f"cannot set {key}: {'.'.join(tables[:depth])} is a value, not a table")
        table = cast("dict[str, Any]", inner)
    table[last] = value
