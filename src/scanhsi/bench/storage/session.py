"""A session: writers in turn, each in a process of its own, then readers; everything is appended to a file as it was seen."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Final, Literal
from uuid import uuid4

import numpy as np

from scanhsi.bench.observations import append_json
from scanhsi.bench.provenance import provenance
from scanhsi.bench.storage.reading import Reading, measure_readers
from scanhsi.bench.storage.rows import ROWS, Row
from scanhsi.bench.storage.work import FULL_GIGE_LPS, Work, synthetic_lines
from scanhsi.bench.storage.worker import Job

SCHEMA: Final = 1
OBSERVATIONS: Final = "storage.jsonl"
"""Name of the file in a benchmark's folder."""

PACKAGES: Final = ("acquire-zarr", "dask", "numcodecs", "numpy", "tensorstore", "xarray", "zarr")

Part = Literal["flat out", "paced", "readers"]
PARTS: Final[tuple[Part, ...]] = ("flat out", "paced", "readers")

Record = dict[str, Any]

_LIMIT_S: Final = 600


@dataclass(frozen=True, slots=True)
class Effort:
    """How much is measured.

    Attributes:
        parts: What.
        rows: Writers; those that are not to be paced are left out there.
        flat_out, paced, reading: Repetitions of each.
        work: Lines of a cube and their size, flat out.
        rate: Lines a second when paced.
        paced_lines: Of a paced run.
        reading_lines: Of the cube that is read.
        frames: Different frames, made beforehand, that the lines repeat.
    """

    parts: Sequence[Part] = PARTS
    rows: Sequence[Row] = ROWS
    flat_out: int = 5
    paced: int = 3
    reading: int = 5
    work: Work = Work(480)  # noqa: RUF009 - frozen
    rate: float = FULL_GIGE_LPS
    paced_lines: int = 448
    reading_lines: int = 1200
    frames: int = 32


def run_session(effort: Effort, output: Path, *, tell: Callable[[str], None] = lambda _: None) -> list[Record]:
    """Measure.

    Args:
        effort: How much.
        output: Folder of the observations, and, while it runs, of the cubes: it is its disk that is measured.
        tell: Told now and then how far it got.

    Returns:
        What was appended to the file of observations; the first record is that of the session.

    Raises:
        CubeError: The observations cannot be written.
    """
    output.mkdir(parents=True, exist_ok=True)
    session, records = uuid4().hex[:12], list[Record]()

    def add(record: str, **seen: Any) -> None:
        records.append({"record": record, "session": session, **seen})
        append_json(output / OBSERVATIONS, records[-1])

    missing = {row.key: str(row.needs) for row in effort.rows if not row.is_there}
    add("session", schema=SCHEMA, **provenance(), packages=_versions(), load=os.getloadavg(), missing=missing)
    with tempfile.TemporaryDirectory(prefix="bench-storage-", dir=output) as scratch:
        folder = Path(scratch).resolve()
        frames = folder / "frames.npy"
        np.save(frames, synthetic_lines(effort.work.bands, effort.work.samples, effort.frames))
        run = partial(_run, frames=frames, folder=folder)
        rows = [row for row in effort.rows if row.is_there]
        if "flat out" in effort.parts:
            for turn in range(effort.flat_out):
                for row in _from(rows, turn):
                    add("flat out", repetition=turn, **run(row, effort.work))
                tell(f"flat out: {turn + 1} of {effort.flat_out}")
        if "paced" in effort.parts:
            paced = replace(effort.work, lines=effort.paced_lines, rate=effort.rate)
            for turn in range(effort.paced):
                for row in _from([row for row in rows if row.paced], turn):
                    add("paced", repetition=turn, **run(row, paced))
                tell(f"paced: {turn + 1} of {effort.paced}")
        if "readers" in effort.parts:
            work = replace(effort.work, lines=effort.reading_lines)
            _read(Reading(work, effort.reading, frames, folder), add, tell)
    return records


def _from(rows: list[Row], turn: int) -> list[Row]:
    """Each repetition begins elsewhere, so that what else the machine does hits all alike."""
    start = turn * 3 % max(1, len(rows))
    return rows[start:] + rows[:start]


def _run(row: Row, work: Work, *, frames: Path, folder: Path) -> Record:
    """What the worker says, or why it said nothing."""
    job = Job(row.key, work, str(frames), str(folder / "bench.zarr"))
    command = [sys.executable, "-m", "scanhsi.bench.storage.worker", job.encoded()]
    seen: Record = {"row": row.key, "work": asdict(work), "load": os.getloadavg()[0]}
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=_LIMIT_S, check=False)
    except subprocess.TimeoutExpired:
        return {**seen, "error": f"it did not end within {_LIMIT_S} s"}
    if done.returncode == 0 and done.stdout:
        return {**seen, **json.loads(done.stdout)}
    said = done.stderr.strip().splitlines() or [f"exit status {done.returncode}"]
    return {**seen, "error": said[-1], "stderr": done.stderr[-4000:]}


def _read(reading: Reading, add: Callable[..., None], tell: Callable[[str], None]) -> None:
    for seen in measure_readers(reading):
        add("read", work=asdict(reading.work), load=os.getloadavg()[0], **seen)
        tell(f"readers: {seen['layout']}, {'cold' if seen['cold'] else 'warm'}, {seen['repetition'] + 1}")


def _versions() -> dict[str, str]:
    found: dict[str, str] = {}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found
