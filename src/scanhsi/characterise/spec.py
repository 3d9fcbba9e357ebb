"""The specification sheet: Table 7 of the paper, and more, every row from a stored result.

A row that nothing was measured for says so; nothing is filled in from a data sheet without naming it as one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Final

from scanhsi.calibration.kinds import KINDS
from scanhsi.calibration.result import Provenance, Result
from scanhsi.characterise.spec_instrument import instrument_rows
from scanhsi.characterise.spec_row import Row, Timing
from scanhsi.characterise.spec_rows import result_rows, timing_rows
from scanhsi.instrument import InstrumentConfig

TABLE_7: Final[Mapping[str, tuple[str, str]]] = {
    "wavelength range": ("Wavelength range", "400-1000 nm"),
    "spectral resolution": ("Spectral resolution", "3 nm per channel, 200 channels"),
    "exposure range": ("Exposure range", "10-1000 us (must mean ms)"),
    "resolution": ("Resolution (max.)", "1200 x 1200"),
    "steps": ("Steps per mirror revolution", "19,200"),
    "rotation": ("Rotation range of the mirror", "pi/8 rad"),
    "optics": ("Focusing optics", "5-50 mm, f/1.3"),
    "field of view": ("Field of view", "7 x 7 cm (min.)"),
    "depth of field": ("Depth of field", "variable"),
    "snr": ("Signal to noise ratio", "up to 30 dB"),
    "gain": ("Camera gain", "0-25 dB"),
    "microstepping": ("Intensity distortion by microstepping", "< 10 % per pixel"),
    "efficiency": ("Efficiency at 8 bit, 100 ms", "75 %"),
    "usaf": ("USAF 1951, best resolved distance", "0.5 mm at 35 cm"),
}
"""Key -> title, and what the paper's table says of its instrument."""

NOT_MEASURED: Final = "not measured"


@dataclass(frozen=True, slots=True)
class Sheet:
    """A specification sheet.

    Attributes:
        name: Of the instrument.
        simulated: Whether any row is of a simulated instrument.
        all_simulated: Whether every row that was measured is.
        table: Rows of Table 7, all of them, in its order.
        further: What else was measured.
        created: When, ISO 8601, UTC.
        version: Of scanhsi.
    """

    name: str
    simulated: bool
    all_simulated: bool
    table: tuple[Row, ...]
    further: tuple[Row, ...]
    created: str = field(default_factory=lambda: datetime.now(UTC).isoformat(timespec="seconds"))
    version: str = field(default_factory=lambda: version("scanhsi"))


def specification(
    results: Sequence[tuple[str, Result]],
    *,
    instrument: InstrumentConfig | None = None,
    timings: Sequence[Timing] = (),
) -> Sheet:
    """Build the sheet.

    Args:
        results: Name of its file, and the result. Of several of a kind, the youngest is used for each row.
        instrument: Its file, for what is not measured but set: limits, steps of a turn.
        timings: From the bench.
    """
    ordered = sorted(results, key=lambda pair: _time_of(pair[1].provenance))
    rows = [row for name, result in ordered for row in result_rows(result, name)]
    rows += timing_rows(timings)
    if instrument is not None:
        measured = {row.key for row in rows}
        rows += [row for row in instrument_rows(instrument) if row.key not in measured]
    youngest = {row.key: row for row in rows}  # later ones replace earlier ones
    youngest |= _worse_bar(youngest)
    if "wavelength range" not in youngest and "wavelength range tile" in youngest:
        youngest["wavelength range"] = replace(youngest.pop("wavelength range tile"), key="wavelength range")
    table = tuple(
        replace(youngest[key], title=title, paper=paper)
        if key in youngest
        else Row(key, title, NOT_MEASURED, paper=paper)
        for key, (title, paper) in TABLE_7.items()
    )
    by_kind = sorted(results, key=lambda pair: list(KINDS).index(pair[1].kind))
    places = [row.key for name, result in by_kind for row in result_rows(result, name)]
    rest = [row for key, row in youngest.items() if key not in TABLE_7]
    further = tuple(sorted(rest, key=lambda row: places.index(row.key) if row.key in places else len(places)))
    told = [row.simulated for row in (*table, *further) if row.simulated is not None]
    name = instrument.name if instrument else "line-scanning imager"
    return Sheet(name, any(told), bool(told) and all(told), table, further)


def _worse_bar(rows: Mapping[str, Row]) -> dict[str, Row]:
    """The paper's resolution: the larger bar of both axes, once both were measured."""
    both = [rows[key] for key in ("usaf line", "usaf sample") if key in rows]
    if len(both) < 2 or any(row.number is None for row in both):
        return {}
    return {"usaf": replace(max(both, key=lambda row: row.number or 0.0), key="usaf")}


def _time_of(provenance: Provenance) -> str:
    return provenance.taken or provenance.created
