"""Raw observations of line benchmarks: one append-only file of JSON lines.

Each session begins with one object that says where it comes from (``record: session``); then comes one object a scan
(``record: scan``) with the stamps of its lines as they were taken, in ns from the scan's first stamp, null where a stage was not
stamped. Nothing is averaged: whatever is drawn or fitted can be computed from this file.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, cast

import numpy as np
from numpy.typing import NDArray

from scanhsi.cube.records import NOT_STAMPED, STAGES, LineRecords
from scanhsi.devices.errors import CubeError
from scanhsi.timing.observed import deliveries

SCHEMA: Final = 1
OBSERVATIONS: Final = "observations.jsonl"
"""Name of the file in a benchmark's folder."""


@dataclass(frozen=True, slots=True)
class Observation:
    """One scan of a sweep.

    Attributes:
        mode: Scan mode.
        scenario: `Scenario` value.
        pixel_format: On the link.
        exposure_s: As applied.
        seed: Of simulated devices; None for real ones.
        lines: Planned.
        missing: Lines lost, with their reasons.
        stamps: Stage -> int64 (lines,), ns from the first stamp, `NOT_STAMPED` where absent.
    """

    mode: str
    scenario: str
    pixel_format: str
    exposure_s: float
    seed: int | None
    lines: int
    missing: dict[int, str]
    stamps: dict[str, NDArray[np.int64]]

    @property
    def periods_s(self) -> NDArray[np.float64]:
        """Time from one line delivered to the next, in s, float64; see `deliveries`. A lost line makes its successor's longer."""
        return np.diff(deliveries(self.stamps)) * 1e-9


def observation(
    records: LineRecords, *, mode: str, scenario: str, pixel_format: str, exposure_s: float, seed: int | None
) -> Observation:
    """The observation that the records of a scan are."""
    taken = [column[column != NOT_STAMPED] for column in records.stamps.values()]
    origin = min((int(column.min()) for column in taken if len(column)), default=0)
    stamps = {
        stage: np.where(column == NOT_STAMPED, NOT_STAMPED, column - np.where(column == NOT_STAMPED, 0, origin))
        for stage, column in records.stamps.items()
    }
    return Observation(
        mode, scenario, pixel_format, exposure_s, seed, records.lines, dict(sorted(records.missing.items())), stamps
    )


class Journal:
    """Appends a session to a file; every scan is on disk before the next begins."""

    def __init__(self, path: Path, session: str) -> None:
        self._path = path
        self._session = session

    def begin(self, facts: dict[str, Any]) -> None:
        """Write what the session is.

        Raises:
            CubeError: The file cannot be written.
        """
        append_json(self._path, {"record": "session", "schema": SCHEMA, "session": self._session, **facts})

    def add(self, seen: Observation) -> None:
        """Write one scan."""
        stamps = {
            stage: [None if stamp == NOT_STAMPED else stamp for stamp in column.tolist()]
            for stage, column in seen.stamps.items()
            if (column != NOT_STAMPED).any()
        }
        append_json(
            self._path,
            {
                "record": "scan",
                "session": self._session,
                "mode": seen.mode,
                "scenario": seen.scenario,
                "pixel_format": seen.pixel_format,
                "exposure_s": seen.exposure_s,
                "seed": seen.seed,
                "lines": seen.lines,
                "missing": seen.missing,
                "stamps_ns": stamps,
            },
        )


def append_json(path: Path, value: dict[str, Any]) -> None:
    """Append one object to a file of JSON lines.

    Raises:
        CubeError: It cannot be written.
    """
    try:
        with path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(value, ensure_ascii=False) + "\n")
    except OSError as error:
        raise CubeError(f"cannot write {path}: {error.strerror or error}.") from error


@dataclass(frozen=True, slots=True)
class Session:
    """One session of a file.

    Attributes:
        facts: Instrument, devices, provenance, as written.
        observations: Its scans, in order.
    """

    facts: dict[str, Any]
    observations: list[Observation]


def read_sessions(path: Path) -> list[Session]:
    """All sessions of a file, in order. A last line that was cut off is left out.

    Raises:
        CubeError: The file cannot be read, or a newer scanhsi wrote it.
    """
    sessions: dict[str, Session] = {}
    for value in _objects(path):
        name = str(value["session"])
        if value["record"] == "session":
            if value["schema"] > SCHEMA:
                raise CubeError(f"{path} has schema {value['schema']}; this scanhsi reads up to {SCHEMA}.")
            sessions[name] = Session(value, [])
        else:
            sessions[name].observations.append(_observation_of(value))
    return list(sessions.values())


def _objects(path: Path) -> Iterator[dict[str, Any]]:
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except OSError as error:
        raise CubeError(f"cannot read {path}: {error.strerror or error}.") from error
    for number, line in enumerate(lines, 1):
        try:
            yield json.loads(line)
        except json.JSONDecodeError as error:
            if number < len(lines):
                raise CubeError(f"{path}, line {number} is not JSON: {error}.") from error


def _observation_of(value: dict[str, Any]) -> Observation:
    lines = int(value["lines"])
    written = cast("dict[str, list[int | None]]", value["stamps_ns"])
    stamps = {stage: np.full(lines, NOT_STAMPED, np.int64) for stage in STAGES}
    for stage, column in written.items():
        stamps[stage] = np.array([NOT_STAMPED if stamp is None else stamp for stamp in column], np.int64)
    missing = cast("dict[str, str]", value["missing"])
    return Observation(
        mode=value["mode"],
        scenario=value["scenario"],
        pixel_format=value["pixel_format"],
        exposure_s=value["exposure_s"],
        seed=value["seed"],
        lines=lines,
        missing={int(line): reason for line, reason in missing.items()},
        stamps=stamps,
    )
