"""One writer, one cube, in a process of its own: ``python -m scanhsi.bench.storage.worker``; see `Job`."""

from __future__ import annotations

import gc
import json
import os
import shutil
import sys
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from scanhsi import clock
from scanhsi.bench.storage.rows import BY_KEY, Row
from scanhsi.bench.storage.work import Taken, Work, measure

_PACKAGES: Final = {
    "acquire_zarr": "acquire-zarr",
    "numcodecs": "numcodecs",
    "numpy": "numpy",
    "tensorstore": "tensorstore",
    "zarr": "zarr",
}
"""Module -> its distribution, where its version matters."""

_WARM_UP_SHARDS: Final = 2


@dataclass(frozen=True, slots=True)
class Job:
    """What a worker is told, as JSON in its only argument.

    Attributes:
        row: Key of a `Row`.
        work: The work.
        frames: File of (count, band, sample) uint16 frames, as numpy saves them.
        path: Of the cube; removed in the end.
    """

    row: str
    work: Work
    frames: str
    path: str

    def encoded(self) -> str:
        """For the command line."""
        return json.dumps(asdict(self))

    @classmethod
    def decoded(cls, text: str) -> Job:
        """What `encoded` made."""
        told = json.loads(text)
        return cls(told["row"], Work(**told["work"]), told["frames"], told["path"])


def run(job: Job) -> dict[str, Any]:
    """Write, once to warm up and once for the numbers; what was stored is compared with what was given."""
    frames = np.load(job.frames)
    row, work = BY_KEY[job.row], replace(job.work, filled=BY_KEY[job.row].filled)
    few = min(work.lines, _WARM_UP_SHARDS * work.layout().lines_per_shard)
    _write(row, replace(work, lines=few, rate=None), frames, Path(job.path))
    gc.collect()
    taken = _write(row, work, frames, Path(job.path))
    versions = {name: version(name) for module, name in _PACKAGES.items() if module in sys.modules}
    return {**taken.as_json(), "versions": versions}


def _write(row: Row, work: Work, frames: NDArray[np.uint16], path: Path) -> Taken:
    try:
        return clock.run(measure(work, frames, lambda: row.make(path, work), path))
    finally:
        shutil.rmtree(path, ignore_errors=True)


def main() -> None:
    """Print one JSON object."""
    out = os.dup(1)
    os.dup2(2, 1)  # whatever a library prints is not the result
    result = run(Job.decoded(sys.argv[1]))
    os.write(out, json.dumps(result).encode())
    sys.stdout.flush()
    os._exit(0)  # libraries keep threads that take their time to end


if __name__ == "__main__":
    main()
