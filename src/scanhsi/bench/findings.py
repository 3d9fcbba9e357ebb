"""What lies in folders of results that a figure can be made of: stored results, records of the bench, tables of bars."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, TypeVar, cast

import xarray as xr

from scanhsi.calibration.result import Result, load
from scanhsi.devices.errors import CalibrationError

R = TypeVar("R", bound=Result)

_RECORDS: Final = '{"record": "session"'
_BARS: Final = "axis,bar_mm,"


@dataclass(slots=True)
class Found:
    """What lies in some folders.

    Attributes:
        results: When each result was taken, its kind and its file; oldest first.
        records: Files of the bench.
        bars: Tables of where the bars of a target are.
    """

    results: list[tuple[str, str, Path]] = field(default_factory=list[tuple[str, str, Path]])
    records: list[Path] = field(default_factory=list[Path])
    bars: list[Path] = field(default_factory=list[Path])

    def of(self, kind: type[R]) -> Iterator[tuple[R, Path]]:
        """Results of a kind with their files, youngest first."""
        return ((load(kind, path), path) for _, name, path in reversed(self.results) if name == kind.kind)

    def youngest(self, kind: type[R], wanted: Callable[[R], bool] = lambda _: True) -> tuple[R, Path] | None:
        """The youngest result of a kind that is wanted, and its file."""
        return next((pair for pair in self.of(kind) if wanted(pair[0])), None)


def look_through(places: Iterable[Path]) -> Found:
    """Find results, records and tables in files and folders, and in theirs; cubes are not entered.

    Raises:
        CalibrationError: A place does not exist.
    """
    found = Found()
    for place in places:
        if not place.exists():
            raise CalibrationError(f"there is no {place}.")
        for file in [place] if place.is_file() else _files(place):
            if file.suffix == ".nc" and (told := _told(file)) is not None:
                found.results.append((*told, file))
            elif file.suffix == ".jsonl" and _begins(file, _RECORDS):
                found.records.append(file)
            elif file.suffix == ".csv" and _begins(file, _BARS):
                found.bars.append(file)
    found.results.sort(key=lambda one: one[0])
    return found


def _files(folder: Path) -> Iterable[Path]:
    for path in sorted(folder.iterdir()):
        if path.is_dir():
            if not (path / "zarr.json").exists():
                yield from _files(path)
        else:
            yield path


def _told(path: Path) -> tuple[str, str] | None:
    """When a result was taken, and its kind; None for another file."""
    try:
        with xr.open_dataset(path, engine="h5netcdf") as dataset:
            kind, provenance = dataset.attrs.get("scanhsi_calibration"), dataset.attrs.get("provenance", "{}")
        told = cast("dict[str, Any]", json.loads(provenance))
    except (OSError, ValueError):
        return None
    return (str(told.get("taken") or told.get("created")), str(kind)) if kind else None


def _begins(path: Path, text: str) -> bool:
    try:
        with path.open("rb") as file:
            return file.read(len(text)) == text.encode()
    except OSError:
        return False
