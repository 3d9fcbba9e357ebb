"""Reads the text headers of ENVI files. Errors name the key and its line in the file."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from scanhsi.devices.errors import CubeError

_Value = TypeVar("_Value")

_TO_NM: Final = {
    "nanometers": 1.0,
    "nanometer": 1.0,
    "nm": 1.0,
    "micrometers": 1e3,
    "micrometer": 1e3,
    "microns": 1e3,
    "um": 1e3,
}


@dataclass(frozen=True, slots=True)
class EnviHeader:
    """Keys of a header, in lower case, with their values as text and the lines they stand in.

    Attributes:
        path: The header.
        values: Key -> text, without braces.
        lines: Key -> number of its line, from 1.
    """

    path: Path
    values: dict[str, str]
    lines: dict[str, int]

    def problem(self, key: str, what: str, *, hint: str | None = None) -> CubeError:
        """An error about a key."""
        place = f", line {self.lines[key]}" if key in self.lines else ""
        found = f"{key} = {_shortened(self.values[key])}" if key in self.values else f"no key {key!r}"
        return CubeError(f"{self.path}{place}: {found}: {what}", hint=hint)

    def integer(self, key: str, *, least: int, default: int | None = None) -> int:
        """A whole number, at least ``least``; the default where the key is missing, an error where there is none."""
        if key not in self.values and default is not None:
            return default
        number = self._parsed(key, int, "a whole number is needed.")
        if number < least:
            raise self.problem(key, f"at least {least} is needed.")
        return number

    def number(self, key: str) -> float | None:
        """A number, or None."""
        return self._parsed(key, float, "a number is needed.") if key in self.values else None

    def numbers(self, key: str, count: int | None = None) -> NDArray[np.float64] | None:
        """A list of numbers, as many as ``count`` where that is given; or None."""
        if key not in self.values:
            return None
        words = [word for word in re.split(r"[,\s]+", self.values[key]) if word]
        found = self._parsed(key, lambda _: np.array([float(word) for word in words]), "numbers are needed.")
        if count is not None and len(found) != count:
            raise self.problem(key, f"{count} are needed, one for each band; these are {len(found)}.")
        return found

    def choice(self, key: str, choices: dict[str, _Value], default: str | None = None) -> _Value:
        """One of some words."""
        word = (self.values.get(key) or default or "").strip().lower()
        if word not in choices:
            raise self.problem(key, f"one of {', '.join(choices)} is needed.")
        return choices[word]

    def _parsed(self, key: str, parse: Callable[[str], _Value], needed: str) -> _Value:
        if key not in self.values:
            raise self.problem(key, needed)
        try:
            return parse(self.values[key])
        except ValueError:
            raise self.problem(key, needed) from None


def read_header(path: Path) -> EnviHeader:
    """Read a header.

    Raises:
        CubeError: It is none, or a line of it makes no sense.
    """
    try:
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError as error:
        raise CubeError(f"cannot read {path}: {error.strerror or error}.") from error
    if not lines or lines[0].lstrip("\ufeff").strip() != "ENVI":
        raise CubeError(f"{path}, line 1: an ENVI header begins with the word ENVI.")
    header = EnviHeader(path, {}, {})
    number = 1
    while number < len(lines):
        number = _read_key(header, lines, number)
    return header


def _read_key(header: EnviHeader, lines: list[str], index: int) -> int:
    """Read what begins at a line (counted from 0); return the index of the line after it."""
    text = lines[index]
    if not text.strip() or text.lstrip().startswith(";"):
        return index + 1
    key, equals, value = text.partition("=")
    key, value = " ".join(key.lower().split()), value.strip()
    if not equals or not key:
        raise CubeError(f"{header.path}, line {index + 1}: {_shortened(text)!r} is no 'key = value'.")
    end = index + 1
    if value.startswith("{"):
        parts = [value]
        while "}" not in parts[-1]:
            if end == len(lines):
                raise CubeError(f"{header.path}, line {index + 1}: the brace after {key!r} is never closed.")
            parts.append(lines[end])
            end += 1
        value = "\n".join(parts)[1:].rpartition("}")[0].strip()
    header.values[key] = value
    header.lines[key] = index + 1
    return end


def wavelengths(header: EnviHeader, key: str, bands: int, notes: list[str]) -> NDArray[np.float64] | None:
    """``wavelength`` or ``fwhm`` in nm; None where there are none, or in a unit that is no length."""
    values = header.numbers(key, bands)
    if values is None:
        return None
    unit = header.values.get("wavelength units", "").strip().lower()
    if unit in _TO_NM:
        return values * _TO_NM[unit]
    if unit in ("", "unknown"):
        centres = header.numbers("wavelength", bands)
        micrometres = centres is not None and float(np.max(centres)) < 100
        notes.append(f"{key} has no units; taken for {'micrometres' if micrometres else 'nm'}, as its size suggests")
        return values * 1e3 if micrometres else values
    notes.append(f"{key} is in {unit!r}, which is no wavelength: kept in the attributes only")
    return None


def _shortened(text: str) -> str:
    text = " ".join(text.split())
    return text if len(text) <= 60 else f"{text[:57]}..."
