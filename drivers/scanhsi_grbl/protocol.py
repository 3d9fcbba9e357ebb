"""Lines that GRBL 1.1 writes, and the single characters that act on it at once.

``ok`` and ``error:N`` answer lines, in order; everything else comes when it comes. There are no sequence numbers and no check
sums: what is damaged is seen only by its form.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import IntEnum, unique


@unique
class Realtime(IntEnum):
    """Characters that need no line and act at once."""

    STATUS = ord("?")
    HOLD = ord("!")
    RESET = 0x18
    CANCEL_JOG = 0x85


@dataclass(frozen=True, slots=True)
class Ok:
    """The line was understood; a motion is queued, not done."""


@dataclass(frozen=True, slots=True)
class Error:
    """The line was refused."""

    code: int


@dataclass(frozen=True, slots=True)
class Alarm:
    """Something is wrong; until it is unlocked, the controller moves nothing."""

    code: int


@dataclass(frozen=True, slots=True)
class Banner:
    """The controller has (re)started."""

    text: str


@dataclass(frozen=True, slots=True)
class Setting:
    """One line of ``$$``."""

    number: int
    value: float


@dataclass(frozen=True, slots=True)
class Feedback:
    """A bracketed message: version, options, or words for people."""

    text: str


@dataclass(frozen=True, slots=True)
class Report:
    """A status report.

    Attributes:
        state: ``Idle``, ``Run``, ``Hold``, ``Jog``, ``Alarm``, ``Door``, ``Check``, ``Home`` or ``Sleep``.
        stage: The digit behind it; of ``Hold``, 0 = stands, 1 = slows down.
        machine: Position of the axes in the controller's unit; None where the report has only work coordinates.
        work: Position in work coordinates; None where the report has machine coordinates.
        offset: Work coordinates + this = machine coordinates; only in some reports.
    """

    state: str
    stage: int
    machine: tuple[float, ...] | None
    work: tuple[float, ...] | None
    offset: tuple[float, ...] | None


@dataclass(frozen=True, slots=True)
class Noise:
    """Anything else: start-up lines, echoes, damage."""

    text: str


Message = Ok | Error | Alarm | Banner | Setting | Feedback | Report | Noise

_NUMBERED = re.compile(r"(error|ALARM):(\d{1,3})")
_SETTING = re.compile(r"\$(\d{1,3})=(\d+(?:\.\d*)?)(?:\s.*)?")
_STATES = frozenset(("Idle", "Run", "Hold", "Jog", "Alarm", "Door", "Check", "Home", "Sleep"))


def parse(line: str) -> Message:
    """What a line says; never raises."""
    if line == "ok":
        return Ok()
    if numbered := _NUMBERED.fullmatch(line):
        return (Error if numbered[1] == "error" else Alarm)(int(numbered[2]))
    if line.startswith(("Grbl ", "GrblHAL ")):
        return Banner(line)
    if line.startswith("<") and line.endswith(">"):
        return _report(line[1:-1]) or Noise(line)
    if setting := _SETTING.fullmatch(line):
        return Setting(int(setting[1]), float(setting[2]))
    if line.startswith("[") and line.endswith("]"):
        return Feedback(line[1:-1])
    return Noise(line)


def _report(body: str) -> Report | None:
    head, *fields = body.split("|")
    state, _, stage = head.partition(":")
    named = {name: value for name, _, value in (field.partition(":") for field in fields)}
    try:
        machine, work, offset = (_numbers(named.get(name)) for name in ("MPos", "WPos", "WCO"))
        number = int(stage or 0)
    except ValueError:
        return None
    if state not in _STATES or (machine is None and work is None):
        return None
    return Report(state, number, machine, work, offset)


def _numbers(text: str | None) -> tuple[float, ...] | None:
    return None if text is None else tuple(float(word) for word in text.split(","))
