"""Quantities as a person writes them: ``"100 ms"``, ``"348.73 mm"``, ``"3 dB"``, ``"8 MiB"``.

The rule is that a unit stands either in the value or in the name, never nowhere. A field is declared with its unit in its name
and with the plain word as its alias, in a model derived from `Written`::

    class Plan(Written):
        exposure_s: Seconds = Field(alias="exposure", gt=0)

Then ``exposure = "100 ms"`` (a file, the command line, Python) and ``exposure_s = 0.1`` (Python, JSON) mean the same, and
``exposure = 100`` is refused with the request for a unit: nobody can tell 100 ms from 100 s. Values are held in SI units as
plain ``float`` (bytes and steps as ``int``), and ``model_dump()`` writes the names with units.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal
from typing import Annotated, Any, Final, cast

from pydantic import BaseModel, ConfigDict, GetCoreSchemaHandler, GetJsonSchemaHandler, model_validator
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

_WRITTEN: Final = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*([^\s\d.+-]\S*)?\s*")


@dataclass(frozen=True, slots=True, eq=False)
class Unit:
    """A kind of quantity: the units it may be written in, and the one it is held in.

    Attributes:
        name: SI unit in which values are held.
        suffix: How field names end that hold it (``exposure_s``).
        factors: Written unit -> what it is in ``name``, the plain ones in ascending order.
        examples: How it may be written.
        whole: Values are integers.
        shown: Units that `format_quantity` uses, ascending.
    """

    name: str
    suffix: str
    factors: Mapping[str, Decimal]
    examples: tuple[str, ...]
    whole: bool = False
    shown: tuple[str, ...] = ()

    def parse(self, value: object) -> object:
        """Turn what was written into a number in ``name``; whatever is not text is left to pydantic's own check.

        Raises:
            PydanticCustomError: Not a number with one of the units.
        """
        if isinstance(value, _Bare):
            raise self._refusal("has no unit")
        if isinstance(value, bool):
            raise self._refusal("is not a quantity")
        if not isinstance(value, str):
            return value
        match = _WRITTEN.fullmatch(value)
        if match is None:
            raise self._refusal("is not a number with a unit")
        number, unit = match.groups()
        if unit is None:
            raise self._refusal("has no unit")
        if unit not in self.factors:
            raise self._refusal(f"has the unit {unit!r}")
        result = Decimal(number) * self.factors[unit]
        if not self.whole:
            return float(result)
        if result != result.to_integral_value():
            raise self._refusal(f"is not a whole number of {self.name}")
        return int(result)

    def _refusal(self, fault: str) -> PydanticCustomError:
        return PydanticCustomError(
            "quantity",
            "{fault}; write a number with one of the units {units}, for example {example}",
            {
                "fault": fault,
                "units": ", ".join(unit for unit in self.factors if not unit.startswith("μ")),
                "example": f'"{self.examples[0]}"',
            },
        )

    def __get_pydantic_core_schema__(self, source: type[Any], handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_before_validator_function(self.parse, handler(source))

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        units = "|".join(re.escape(unit) for unit in self.factors)
        return {
            "type": "string",
            "pattern": rf"^\s*[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?\s*({units})\s*$",
            "examples": list(self.examples),
        }


@dataclass(frozen=True, slots=True)
class _Bare:
    """A number that stands under a name that tells no unit."""

    value: float

    def __repr__(self) -> str:
        return repr(self.value)


class Written(BaseModel):
    """Base of models that a person fills in: frozen, unknown keys refused, a unit in the name or in the value."""

    model_config = ConfigDict(frozen=True, extra="forbid", populate_by_name=True, allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _mark_bare_numbers(cls, data: Any) -> Any:
        """Mark numbers under an alias without unit, for `Unit.parse` to refuse each with its own message."""
        if not isinstance(data, Mapping):
            return data
        needing = {
            field.alias
            for name, field in cls.model_fields.items()
            if field.alias and name.removeprefix(f"{field.alias}_") in _SUFFIXES
        }
        table = cast("Mapping[str, Any]", data)
        return {key: _marked(value) if key in needing else value for key, value in table.items()}


def _marked(value: Any) -> Any:
    if isinstance(value, int | float):
        return _Bare(value)
    if isinstance(value, list | tuple):
        return [_marked(item) for item in cast("list[Any]", value)]
    return value


def _powers(**exponents: int) -> dict[str, Decimal]:
    return {unit: Decimal(1).scaleb(exponent) for unit, exponent in exponents.items()}


_TIME: Final = Unit(
    "s",
    "s",
    {**_powers(ns=-9, us=-6), "µs": Decimal("1e-6"), "μs": Decimal("1e-6"), **_powers(ms=-3, s=0), "min": Decimal(60)},
    ("100 ms", "1.5 s", "350 us"),
    shown=("ns", "us", "ms", "s"),
)
_LENGTH: Final = Unit(
    "m",
    "m",
    {**_powers(nm=-9, um=-6), "µm": Decimal("1e-6"), "μm": Decimal("1e-6"), **_powers(mm=-3, cm=-2, m=0)},
    ("348.73 mm", "0.35 m"),
    shown=("nm", "um", "mm", "m"),
)
_LEVEL: Final = Unit("dB", "db", {"dB": Decimal(1)}, ("3 dB", "0 dB"), shown=("dB",))
_SIZE: Final = Unit(
    "B",
    "bytes",
    {
        **_powers(B=0, kB=3, MB=6, GB=9),
        "KiB": Decimal(2**10),
        "MiB": Decimal(2**20),
        "GiB": Decimal(2**30),
    },
    ("8 MiB", "64 MB"),
    whole=True,
    shown=("B", "KiB", "MiB", "GiB"),
)
_STEPS: Final = Unit(
    "steps",
    "steps",
    {"step": Decimal(1), "steps": Decimal(1)},
    ("1200 steps",),
    whole=True,
    shown=("steps",),
)
_UNITS: Final = {unit.name: unit for unit in (_TIME, _LENGTH, _LEVEL, _SIZE, _STEPS)}
_SUFFIXES: Final = frozenset(unit.suffix for unit in _UNITS.values())

Seconds = Annotated[float, _TIME]
"""A time, held in s; for fields named ``*_s``."""
Metres = Annotated[float, _LENGTH]
"""A length, held in m; for fields named ``*_m``."""
Decibels = Annotated[float, _LEVEL]
"""A gain, held in dB; for fields named ``*_db``."""
Bytes = Annotated[int, _SIZE]
"""An amount of memory, held in bytes; for fields named ``*_bytes``."""


def parse_steps(value: object) -> object:
    """A number of motor steps: ``12`` (a count needs no unit), ``"12"`` from a command line, or ``"12 steps"``."""
    if isinstance(value, str) and re.fullmatch(r"\s*[+-]?\d+\s*", value):
        return int(value)
    return _STEPS.parse(value)


class _StepsWritten:
    """Annotation of `Steps`."""

    def __get_pydantic_core_schema__(self, source: type[Any], handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_before_validator_function(parse_steps, handler(source))


Steps = Annotated[int, _StepsWritten()]
"""Motor steps: an integer, with or without the word ``steps``."""


def format_quantity(value: float, unit: str, *, digits: int | None = None) -> str:
    """Write a quantity for people: ``format_quantity(0.1, "s")`` is ``"100 ms"``.

    Args:
        value: In ``unit``, finite.
        unit: ``"s"``, ``"m"``, ``"dB"``, ``"B"`` or ``"steps"``.
        digits: Significant digits to round to; None writes every digit, so that parsing gives ``value`` back exactly.
    """
    kind = _UNITS[unit]
    exact = Decimal(repr(value))
    shown = exact if digits is None else Decimal(f"{value:.{digits}g}")
    best = kind.shown[0] if value else kind.name
    for name in kind.shown:
        factor = kind.factors[name]
        if abs(shown) >= factor and not (kind.whole and digits is None and exact % factor):
            best = name
    number = exact / kind.factors[best]
    if digits is not None:
        number = Decimal(f"{number:.{digits}g}")
    return f"{number.normalize():f} {best}"
