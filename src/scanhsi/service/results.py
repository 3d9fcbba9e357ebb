"""Results of calibrations in the data folder, and the specification sheet made of them. Blocking functions."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from scanhsi.calibration.applies import check_applies
from scanhsi.calibration.conditions import Conditions
from scanhsi.calibration.kinds import load_any
from scanhsi.calibration.result import Result
from scanhsi.characterise.spec import specification
from scanhsi.characterise.spec_rows import result_rows
from scanhsi.devices.errors import CalibrationError
from scanhsi.instrument import InstrumentConfig
from scanhsi.service.jobs import plain
from scanhsi.service.models import ResultEntry


def entries(paths: list[Path], now: Conditions) -> list[ResultEntry]:
    """Results, the youngest first; files that are none are left out.

    Args:
        paths: Of files.
        now: Under which cubes would be taken now: what results have to fit.
    """
    return [entry(path, result, now) for path, result in _loaded(paths)]


def entry(path: Path, result: Result, now: Conditions) -> ResultEntry:
    """One of them."""
    provenance = result.provenance
    try:
        check_applies(result, now)
        why_not = None
    except CalibrationError as error:
        why_not = error.message
    taken = provenance.taken or provenance.created
    return ResultEntry(
        id=path.name,
        kind=result.kind,
        taken=taken,
        age_s=_age_s(taken),
        simulated=provenance.simulated,
        temperature_c=provenance.temperature_c,
        applies=why_not is None,
        why_not=why_not,
        conditions=plain(provenance.conditions),
        rows=[plain(row) for row in result_rows(result, path.name)],
    )


def sheet(paths: list[Path], config: InstrumentConfig) -> dict[str, Any]:
    """The specification sheet, plain JSON types."""
    found = [(path.name, result) for path, result in _loaded(paths)]
    return plain(specification(found, instrument=config))


def _loaded(paths: list[Path]) -> list[tuple[Path, Result]]:
    found: list[tuple[Path, Result]] = []
    for path in paths:
        try:
            found.append((path, load_any(path)))
        except CalibrationError:
            continue
    return found


def _age_s(taken: str) -> float | None:
    try:
        then = datetime.fromisoformat(taken)
    except ValueError:
        return None
    if then.tzinfo is None:
        then = then.replace(tzinfo=UTC)
    return (datetime.now(UTC) - then).total_seconds()
