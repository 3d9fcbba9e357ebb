"""Proves that a cube holds what it says it holds: reads and decodes every file that a status vouches for.

What is checked, without a Zarr library in between (those hand out zeros for what is not there):

* every inner chunk of every shard with a stored line is there, decodes to the right size, and fits its checksum where it has
  one, as does the index of the shard;
* the records of every line that was reached are there and have the right length;
* the status makes sense: known values, no hole, reasons for missing lines, as many lines as the cube counted when it was closed.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from scanhsi.cube.described import Description, Problem, describe, folder_of
from scanhsi.cube.layout import STATUS
from scanhsi.cube.leftovers import Leftover, find_leftovers
from scanhsi.cube.pieces import ArrayFiles, Damaged, check_file, read_chunk
from scanhsi.cube.records import LineStatus
from scanhsi.devices.errors import CubeError

_MAX_THREADS: Final = 4


@dataclass(frozen=True, slots=True, eq=False)
class Verification:
    """What a check found.

    Attributes:
        path: Of the cube.
        cube: What its metadata say.
        status: (lines,) uint8, 0 where it could not be read.
        lines_reached: Lines with a status.
        lines_stored: Lines that the cube says are stored.
        lines_missing: Lines that the cube says are missing.
        checksummed: Whether the pixels carry checksums. Without them a flipped bit may still decode, and is then not noticed.
        problems: All of them.
        leftovers: What no reader asks for: harmless.
        notes: Worth knowing, and no problem.
        untidy: The cube was never closed, or is being written: harmless.
    """

    path: Path
    cube: Description
    status: NDArray[np.uint8]
    lines_reached: int
    lines_stored: int
    lines_missing: int
    checksummed: bool
    problems: tuple[Problem, ...]
    leftovers: tuple[Leftover, ...]
    notes: tuple[str, ...]
    untidy: bool

    @property
    def bad_lines(self) -> tuple[int, ...]:
        """Lines that cannot be trusted, and that the cube does not say are missing."""
        return tuple(sorted({line for problem in self.problems for line in problem.lines}))

    @property
    def intact(self) -> bool:
        """Whether everything is as the cube says."""
        return not self.problems


Progress = Callable[[int, int], None]
"""Called with (files checked, files to check), from the calling thread."""


def verify_cube(path: str | Path, *, threads: int | None = None, progress: Progress | None = None) -> Verification:
    """Check a cube; nothing is changed. A cube that is being written is checked as far as it is.

    Memory is a few MB a thread, whatever the size of the cube.

    Args:
        path: The cube.
        threads: That read and decode; by default one a processor, at most 4.
        progress: See `Progress`.

    Raises:
        NotACube: There is no cube.
        CubeError: Its metadata is damaged, or newer than this scanhsi; or it is in an object store.
    """
    cube = describe(folder_of(path))
    status, problems = _status(cube)
    work = [*_pixel_work(cube, status), *_record_work(cube, status)]
    with ThreadPoolExecutor(threads or min(_MAX_THREADS, os.cpu_count() or 1)) as pool:
        for done, found in enumerate(pool.map(_run, work), 1):
            problems += found
            if progress is not None:
                progress(done, len(work))
    pixels = cube.arrays["cube"]
    problems += cube.problems
    if not any(problem.kind == "status" for problem in problems):  # else what follows from that is no news
        problems += _consistency(cube, status)
    reached = _reached(status)
    try:
        leftovers = find_leftovers(cube.path, cube.folders, cube.arrays.values())
    except OSError as error:
        raise CubeError(f"{cube.path} cannot be listed: {error.strerror}.") from error
    certain = not any(problem.kind == "status" for problem in problems)
    leftovers += _never_vouched(cube, status, certain)
    return Verification(
        cube.path,
        cube,
        status,
        lines_reached=reached,
        lines_stored=int(np.count_nonzero(status == LineStatus.STORED)),
        lines_missing=int(np.count_nonzero(status == LineStatus.MISSING)),
        checksummed=pixels.checksummed,
        problems=tuple(sorted(problems, key=lambda problem: (problem.lines[:1], problem.file))),
        leftovers=tuple(leftovers),
        notes=tuple(_notes(cube, status)),
        untidy=reached < pixels.shape[1] or cube.torn_close or cube.acquisition.get("finished") is None,
    )


def _run(check: Callable[[], list[Problem]]) -> list[Problem]:
    return check()


def _status(cube: Description) -> tuple[NDArray[np.uint8], list[Problem]]:
    """The status of every line, 0 where it cannot be read: then nothing vouches for those lines."""
    array = cube.arrays[STATUS.name]
    status = np.zeros(array.shape, np.uint8)
    problems: list[Problem] = []
    closed_with = cube.acquisition.get("lines_reached") if cube.acquisition.get("finished") else None
    for number in range(array.grid()[0]):
        lines = range(number * array.chunk[0], min((number + 1) * array.chunk[0], array.shape[0]))
        try:
            values = read_chunk(array, (number,))
            if values is None and isinstance(closed_with, int) and lines.start < closed_with:
                raise Damaged(f"is not there, and the cube was closed with {closed_with} lines")
        except Damaged as damage:
            reason = f"{damage}; nothing vouches for lines {lines.start} to {lines.stop - 1}"
            problems.append(Problem(cube.name(array.file((number,))), reason, "status", tuple(lines)))
        else:
            if values is not None:
                status[lines.start : lines.stop] = np.frombuffer(values, np.uint8)[: len(lines)]
    return status, problems


def _pixel_work(cube: Description, status: NDArray[np.uint8]) -> Iterable[Callable[[], list[Problem]]]:
    array = cube.arrays["cube"]
    bands, files, samples = array.grid()
    for number in range(files):
        first = number * array.chunk[1]
        stored = np.flatnonzero(status[first : first + array.chunk[1]] == LineStatus.STORED)
        if not stored.size:
            continue
        rows = {int(line) // array.inner[1] for line in stored}
        for band, sample in product(range(bands), range(samples)):
            yield partial(_check_pixels, cube, (band, number, sample), frozenset(rows), status)


def _check_pixels(
    cube: Description, place: tuple[int, int, int], rows: frozenset[int], status: NDArray[np.uint8]
) -> list[Problem]:
    array = cube.arrays["cube"]
    file, first = cube.name(array.file(place)), place[1] * array.chunk[1]
    found: dict[int, list[str]] = {}
    try:
        for row, reason in check_file(array, place, rows, axis=1):
            found.setdefault(row, []).append(reason)
    except Damaged as damage:
        return [Problem(file, str(damage), "pixels", _stored(status, first, first + array.chunk[1]))]
    problems: list[Problem] = []
    for row, reasons in found.items():
        start = first + row * array.inner[1]
        more = f" (and {len(reasons) - 1} more of it)" if len(reasons) > 1 else ""
        problems.append(Problem(file, reasons[0] + more, "pixels", _stored(status, start, start + array.inner[1])))
    return problems


def _stored(status: NDArray[np.uint8], start: int, stop: int) -> tuple[int, ...]:
    """Those of some lines that are stored."""
    return tuple(int(line) + start for line in np.flatnonzero(status[start:stop] == LineStatus.STORED))


def _record_work(cube: Description, status: NDArray[np.uint8]) -> Iterable[Callable[[], list[Problem]]]:
    for array in cube.line_arrays:
        for number in range(array.grid()[0]):
            start, stop = number * array.chunk[0], (number + 1) * array.chunk[0]
            if status[start:stop].any():
                yield partial(_check_record, cube, array, number, _stored(status, start, stop))
    if "wavelength" in cube.arrays:
        for number in range(cube.arrays["wavelength"].grid()[0]):
            yield partial(_check_record, cube, cube.arrays["wavelength"], number, ())


def _check_record(cube: Description, array: ArrayFiles, number: int, lines: tuple[int, ...]) -> list[Problem]:
    try:
        missing = read_chunk(array, (number,)) is None
    except Damaged as damage:
        return [Problem(cube.name(array.file((number,))), str(damage), "records", lines)]
    return [Problem(cube.name(array.file((number,))), "is not there", "records", lines)] if missing else []


def _reached(status: NDArray[np.uint8]) -> int:
    nonzero = np.flatnonzero(status)
    return int(nonzero[-1]) + 1 if nonzero.size else 0


def _consistency(cube: Description, status: NDArray[np.uint8]) -> Iterable[Problem]:
    return (Problem("status", sentence, "status") for sentence in _contradictions(cube, status))


def _contradictions(cube: Description, status: NDArray[np.uint8]) -> Iterable[str]:
    reached = _reached(status)
    strange = np.flatnonzero(status > max(LineStatus))
    if strange.size:
        yield f"line {strange[0]} has status {status[strange[0]]}, which means nothing"
    holes = np.flatnonzero(status[:reached] == LineStatus.NOT_STORED)
    if holes.size:
        yield f"line {holes[0]} is not stored, and later lines are ({holes.size} such lines)"
    if cube.attributes.get("complete") is True and reached < cube.planned:
        yield f"the cube says it is complete, and has {reached} of {cube.planned} lines"
    for name, value in (("lines_stored", LineStatus.STORED), ("lines_missing", LineStatus.MISSING)):
        told, counted = cube.acquisition.get(name), int(np.count_nonzero(status == value))
        if isinstance(told, int) and cube.acquisition.get("finished") and told != counted:
            yield f"the cube counted {told} {name.replace('_', ' ')} when it was closed; now there are {counted}"


def _never_vouched(cube: Description, status: NDArray[np.uint8], certain: bool) -> Iterable[Leftover]:
    """Chunks of lines that no status vouches for: the writer was killed before it got to that.

    They may be good all the same where the status itself is damaged (not ``certain``): then they are nobody's to remove.
    """
    what = "lines that were cut off before they were safe" if certain else "lines whose status may have been lost"
    pixels = cube.arrays["cube"]
    lines_of = {pixels: pixels.chunk[1]} | {array: array.chunk[0] for array in cube.line_arrays}
    if "quicklook" in cube.arrays:
        lines_of[cube.arrays["quicklook"]] = pixels.chunk[1]  # its chunks are smaller, and as many
    for array, lines in lines_of.items():
        axis = 1 if len(array.shape) == 3 else 0
        for place in np.ndindex(*array.grid()):
            first = place[axis] * lines
            file = array.file(place)
            if not status[first : first + lines].any() and file.exists():
                yield Leftover(file, what, file.stat().st_size, ours=certain)


def _notes(cube: Description, status: NDArray[np.uint8]) -> Iterable[str]:
    if not cube.arrays["cube"].checksummed:
        yield "the pixels carry no checksums: files were read and decoded, but a flipped bit may go unnoticed"
    if cube.acquisition.get("finished") is None:
        yield "the scan is still running, or was cut off: what is stored is as good as ever"
    known = cube.missing_reasons
    silent = [line for line in np.flatnonzero(status == LineStatus.MISSING).tolist() if line not in known]
    if silent:
        yield f"{len(silent)} missing lines have no reason recorded, first line {silent[0]}"
