"""Processing of a cube while it grows: shards are made as their lines become safe, the rest when the scan is over.

What follows is a reader of files and nothing else. The scan does not know of it, hands nothing over and waits for nothing:
however slow it is, and whatever becomes of it, no line is lost, and what it has not made it makes from the raw cube afterwards.
The end is what `scanhsi.processing.process` does with ``resume``, so the new cube is the one that it makes of the finished cube.
"""

from __future__ import annotations

import fcntl
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import xarray as xr

from scanhsi.cube.layout import STATUS
from scanhsi.cube.metadata import ROOT
from scanhsi.cube.reader import open_cube
from scanhsi.cube.rewrite import Rewriting, ShardTask, open_source
from scanhsi.cube.shards import Codec
from scanhsi.devices.errors import NotACube
from scanhsi.processing.run import lines_per_shard, work_of
from scanhsi.processing.steps import Step

_LOOK_S: Final = 0.05


@dataclass(frozen=True, slots=True)
class Followed:
    """How it went.

    Attributes:
        lines: Of the new cube.
        behind: Lines that were still to be made when the scan was over.
        caught_up_s: What these took, and closing the new cube.
    """

    lines: int
    behind: int
    caught_up_s: float


def follow(
    cube: str | Path,
    output: str | Path,
    steps: Sequence[Step],
    *,
    codec: Codec = "lz4",
    resume: bool = False,
    over: Callable[[], bool] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Followed:
    """Process a cube into a new one while it is being written.

    Args:
        cube: Folder of the cube; it need not be there yet if ``over`` is given.
        output: Folder of the new cube, which must not exist.
        steps: What to do, in order.
        codec: Of the new cube.
        resume: Go on with what is there of the new cube.
        over: Whether the scan has ended. By default: the cube is closed, or no process has it open for writing.
        progress: Told how many lines are made, and how many there are to be, after every shard.

    Raises:
        CalibrationError: A step does not fit the cube; nothing was written.
        NotACube, CubeExists, CubeError: A cube cannot be read or written.
    """
    path, over = Path(cube), over or _Ended(Path(cube))
    source = _first_lines(path, over)
    seen: dict[int, Any] = {}
    if source is not None:
        seen = _make_ahead(path, Path(output), steps, codec, source, over, resume=resume, progress=progress)
        resume = True
    ended = time.monotonic()
    whole = open_source(path)
    rewriting, _ = work_of(whole, str(cube), Path(output), steps, codec)
    behind = sum(min(rewriting.layout.lines_per_shard, rewriting.spec.lines - first) for first in _missing(rewriting))
    rewriting.run(threads=1, resume=resume, seen=seen)
    return Followed(rewriting.spec.lines, behind, time.monotonic() - ended)


def _first_lines(path: Path, over: Callable[[], bool]) -> xr.Dataset | None:
    """The cube once a line of it is safe; None if the scan was over before."""
    while not over():
        if (path / STATUS.name / "c" / "0").exists():
            return open_source(path)
        time.sleep(_LOOK_S)
    if not (path / ROOT).exists():
        raise NotACube(f"there is no cube at {path}.")
    return None


def _make_ahead(
    path: Path,
    output: Path,
    steps: Sequence[Step],
    codec: Codec,
    source: xr.Dataset,
    over: Callable[[], bool],
    *,
    resume: bool,
    progress: Callable[[int, int], None] | None,
) -> dict[int, Any]:
    """Make whole shards until the scan is over; returns what was seen of each."""
    planned = int(source.attrs["lines_planned"])
    rewriting, _ = work_of(source, str(path), output, steps, codec, lines=planned)
    files = rewriting.open(resume=resume)
    try:
        task, seen = ShardTask(rewriting, files.documents), dict[int, Any]()
        per_shard, first = rewriting.layout.lines_per_shard, 0
        raw_shard = lines_per_shard(source)
        while not over():
            if first + per_shard > planned or not _safe(path, range(first, first + per_shard), raw_shard):
                time.sleep(_LOOK_S)
                continue
            if first + per_shard > source.sizes["line"]:
                source = open_source(path)
                task.look_again(rewriting.on(source))
            seen[first] = task(first)
            first += per_shard
            if progress is not None:
                progress(min(first, planned), planned)
        return seen
    finally:
        files.destination.unlock()


def _safe(path: Path, lines: range, per_shard: int) -> bool:
    """Whether lines of a cube with so many lines a shard are safe: their status is written last."""
    first = lines.start // per_shard
    status = b""
    try:
        for shard in range(first, (lines.stop - 1) // per_shard + 1):
            status += (path / STATUS.name / "c" / str(shard)).read_bytes()
    except FileNotFoundError:
        return False
    return 0 not in status[lines.start - first * per_shard : lines.stop - first * per_shard]


def _missing(rewriting: Rewriting) -> list[int]:
    return [first for first in rewriting.shards() if not rewriting.is_there(first)]


class _Ended:
    """Whether nobody writes a cube any more."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def __call__(self) -> bool:
        """It is closed, or no process has locked it."""
        return not self._locked() or open_cube(self._path, chunks=None).attrs["acquisition"]["finished"] is not None

    def _locked(self) -> bool:
        try:
            descriptor = os.open(self._path, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        except (FileNotFoundError, NotADirectoryError) as error:
            raise NotACube(f"there is no cube at {self._path}.") from error
        try:
            fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except OSError:
            return True
        finally:
            os.close(descriptor)
        return False


def is_over(descriptor: int) -> Callable[[], bool]:
    """Whether the process at the other end of a pipe has closed it, or is gone."""
    os.set_blocking(descriptor, False)

    def over() -> bool:
        try:
            return os.read(descriptor, 1) == b""
        except BlockingIOError:
            return False

    return over
