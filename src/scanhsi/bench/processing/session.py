"""A session: rows in turn, each in a process of its own; everything is appended to a file as it was seen."""

from __future__ import annotations

import asyncio
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final, Literal
from uuid import uuid4

import numpy as np

from scanhsi.bench.observations import append_json
from scanhsi.bench.processing.rows import IN_MEMORY, LIVE, ON_DISK
from scanhsi.bench.processing.work import Size, line_of, write
from scanhsi.bench.processing.worker import FRAMES
from scanhsi.bench.provenance import provenance
from scanhsi.bench.storage.work import synthetic_lines

SCHEMA: Final = 1
OBSERVATIONS: Final = "processing.jsonl"
"""Name of the file in a benchmark's folder."""

OPENHSI: Final = ("openhsi, level 4", "openhsi, level 6")

Part = Literal["memory", "disk", "live"]
PARTS: Final[tuple[Part, ...]] = ("memory", "disk", "live")
Record = dict[str, Any]

_PEER: Final = Path(__file__).parents[4] / "tests" / "benchmarks" / "peers" / "openhsi_processing.py"
_FRAMES: Final = 16
_LIMIT_S: Final = 900


@dataclass(frozen=True, slots=True)
class Effort:
    """How much is measured.

    Attributes:
        parts: What.
        size: Of the raw cube.
        live_lines: Of the cube that is saved at the camera's full rate.
        repetitions: In which the rows of a part take turns.
        openhsi: Python of an environment that has OpenHSI; None leaves it out, as does a scanhsi that is not run from its checkout.
    """

    parts: Sequence[Part] = PARTS
    size: Size = field(default_factory=Size)
    live_lines: int = 1200
    repetitions: int = 3
    openhsi: Path | None = None


def run_session(effort: Effort, output: Path, *, tell: Callable[[str], None] = lambda _: None) -> list[Record]:
    """Measure.

    Args:
        effort: How much.
        output: Folder of the observations, and, while it runs, of the cubes: it is its disk that is measured.
        tell: Told now and then how far it got.

    Returns:
        What was appended to the file of observations; the first record is that of the session.
    """
    output.mkdir(parents=True, exist_ok=True)
    session, records = uuid4().hex[:12], list[Record]()

    def add(record: str, **seen: Any) -> None:
        records.append({"record": record, "session": session, **seen})
        append_json(output / OBSERVATIONS, records[-1])

    add("session", schema=SCHEMA, **provenance(), size=asdict(effort.size), load=os.getloadavg())
    with tempfile.TemporaryDirectory(prefix="bench-processing-", dir=output) as scratch:
        folder = Path(scratch).resolve()
        prepare(effort, folder)
        for part in effort.parts:
            rows = {"memory": IN_MEMORY, "disk": ON_DISK, "live": LIVE}[part]
            size = Size(effort.live_lines, effort.size.bands, effort.size.samples) if part == "live" else effort.size
            for turn in range(effort.repetitions):
                for row in rows:
                    about = {
                        "part": part,
                        "row": row,
                        "repetition": turn,
                        "of_lines": size.lines,
                        "load": os.getloadavg()[0],
                    }
                    add("row", **about, **_run(row, size, folder))
                if part == "memory" and effort.openhsi is not None and _PEER.exists():
                    for row in OPENHSI:
                        add("row", part=part, row=row, repetition=turn, **_run_peer(effort.openhsi, row, folder))
                tell(f"{part}: {turn + 1} of {effort.repetitions}")
    return records


def prepare(effort: Effort, folder: Path) -> None:
    """Make what rows need: frames, and where it is needed a raw cube, and its pixels as the file that is copied beside it."""
    size = effort.size
    frames = synthetic_lines(size.bands, size.samples, _FRAMES)
    np.save(folder / FRAMES, frames)
    if "disk" in effort.parts:
        asyncio.run(write(folder / "raw.zarr", size, frames))
        with (folder / "raw.bin").open("wb") as file:
            for line in range(size.lines):
                file.write(line_of(frames, line).tobytes())
            os.fsync(file.fileno())


def _run(row: str, size: Size, folder: Path) -> Record:
    arguments = [row, *(str(number) for number in (size.lines, size.bands, size.samples)), str(folder)]
    return _told([sys.executable, "-m", "scanhsi.bench.processing.worker", *arguments])


def _run_peer(python: Path, row: str, folder: Path) -> Record:
    core = str(max(os.sched_getaffinity(0)))
    level = row.rpartition(" ")[2]
    return _told(["taskset", "-c", core, str(python), str(_PEER), str(folder / FRAMES), level])


def _told(command: list[str]) -> Record:
    """What a worker says, or why it said nothing."""
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=_LIMIT_S, check=False)
    except (subprocess.TimeoutExpired, OSError) as error:
        return {"error": str(error)}
    if done.returncode == 0 and done.stdout:
        return json.loads(done.stdout)
    said = done.stderr.strip().splitlines() or [f"exit status {done.returncode}"]
    return {"error": said[-1], "stderr": done.stderr[-4000:]}
