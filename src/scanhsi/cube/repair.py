"""Tidies up after a crash, and, where it is told to, writes down what was lost.

By itself it does what loses nothing: temporary files go, a cube that a killed writer left open is closed at the lines reached, and
a damaged metadata file of an array is written anew from the root's copy. ``mark_unreadable`` also takes back promises that the disk
does not keep: lines whose pixels cannot be read become missing, with the reason. The damaged file stays as ``*.damaged``.
"""

from __future__ import annotations

import errno
import json
import os
import shutil
import uuid
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from scanhsi.cube.described import METADATA, Description, describe, folder_of
from scanhsi.cube.durable import PARTIAL, lock_folder, sync_directory, write_durably
from scanhsi.cube.layout import STATUS
from scanhsi.cube.metadata import set_lines
from scanhsi.cube.pieces import Damaged, blank, encode
from scanhsi.cube.records import LineStatus
from scanhsi.cube.verify import Progress, Verification, verify_cube
from scanhsi.devices.errors import CubeError

DAMAGED: Final = ".damaged"
"""Names of damaged files that were set aside end in this."""


@dataclass(frozen=True, slots=True)
class Step:
    """One thing to be done.

    Attributes:
        what: For people, in the imperative.
        act: Does it.
    """

    what: str
    act: Callable[[], None]


def repair_cube(
    path: str | Path,
    *,
    mark_unreadable: bool = False,
    dry_run: bool = False,
    threads: int | None = None,
    progress: Progress | None = None,
    tell: Callable[[str], None] = lambda _: None,
) -> Verification:
    """Check a cube and do what there is to be done. Nobody else can write it meanwhile.

    Args:
        path: The cube.
        mark_unreadable: Lines whose pixels cannot be read become missing; records that cannot be read become "not known".
        dry_run: Only tell.
        threads: Of the check.
        progress: Of the check.
        tell: Called with each step before it is taken.

    Returns:
        What the check found, before anything was done.

    Raises:
        NotACube: There is no cube.
        CubeError: The cube is being written, or cannot be changed. What was done before that stays done; nothing is lost by it.
    """
    path = describe(folder_of(path)).path
    locked: int | None = None
    try:
        locked = None if dry_run else lock_folder(path)
        found = verify_cube(path, threads=threads, progress=progress)
        for step in _plan(found, mark_unreadable):
            tell(step.what)
            if not dry_run:
                step.act()
    except BlockingIOError as error:
        raise CubeError(f"{path} is being written; it was not touched.", hint="again when that has ended") from error
    except OSError as error:
        raise CubeError(f"cannot repair {path}: {error.strerror or error}.") from error
    finally:
        if locked is not None:
            os.close(locked)
    return found


def _plan(found: Verification, mark: bool) -> Iterable[Step]:
    for leftover in found.leftovers:
        if leftover.ours:
            yield Step(f"remove {leftover.path}: {leftover.what}", partial(_remove, leftover.path))
    root = _Root(found.cube)
    for problem in found.problems:
        if problem.kind == "metadata":
            name = Path(problem.file).parent.as_posix()
            yield Step(f"write {problem.file} anew from the root's copy", partial(root.write_array, name))
    status = found.status.copy()
    if mark:
        yield from _mark(found, status, root)
    certain = mark or not any(problem.kind == "status" for problem in found.problems)
    reached = np.flatnonzero(status)
    lines = int(reached[-1]) + 1 if reached.size else 0
    if certain and found.untidy:
        yield Step(f"close the cube at the {lines} lines reached", partial(root.close, status, lines))


def _mark(found: Verification, status: NDArray[np.uint8], root: _Root) -> Iterable[Step]:
    lost = _lost(found, status)
    status[list(lost)] = LineStatus.MISSING
    if lost:
        text = f"mark {len(lost)} lines as missing ({line_ranges(lost)})"
        yield Step(text, partial(_write_status, found.cube, status, lost, root))
    elif any(problem.kind == "status" for problem in found.problems):
        yield Step("count the lines anew", partial(root.count, status))
    for problem in found.problems:
        if problem.kind == "pixels":
            yield Step(
                f"set {problem.file} aside as {Path(problem.file).name}{DAMAGED}",
                partial(_set_aside, found.cube, problem.file, problem.lines),
            )
        elif problem.kind == "records":
            yield Step(f"write {problem.file} anew: not known", partial(_forget, found.cube, problem.file))


def _lost(found: Verification, status: NDArray[np.uint8]) -> dict[int, str]:
    """Lines to be marked -> why."""
    lost: dict[int, str] = {}
    for problem in found.problems:
        if problem.kind in ("pixels", "status"):
            lost |= dict.fromkeys(problem.lines, f"unreadable: {problem.file} {problem.reason}")
    reached = np.flatnonzero(status)
    holes = np.flatnonzero(status[: reached[-1]] == LineStatus.NOT_STORED) if reached.size else reached
    lost |= dict.fromkeys(holes.tolist(), "its status was lost")
    lost |= dict.fromkeys(np.flatnonzero(status > max(LineStatus)).tolist(), "its status was damaged")
    return lost


def _write_status(cube: Description, status: NDArray[np.uint8], lost: dict[int, str], root: _Root) -> None:
    """The reasons first, then the status, as a writer does."""
    root.count(status, lost)
    array = cube.arrays[STATUS.name]
    for number in sorted({line // array.chunk[0] for line in lost}):
        values = np.zeros(array.chunk, np.uint8)
        part = status[number * array.chunk[0] :][: array.chunk[0]]
        values[: len(part)] = part
        write_durably(array.file((number,)), encode(array, values.tobytes()))


def _set_aside(cube: Description, name: str, lines: Iterable[int]) -> None:
    """Keep a damaged file under another name; under its own, zeros stand for the lines that are missing now."""
    file, array = cube.path / name, cube.arrays["cube"]
    if not file.exists():
        return
    kept = file.with_name(file.name + DAMAGED)
    if not kept.exists():
        os.link(file, kept)
    first = int(file.relative_to(array.folder).parts[2]) * array.chunk[1]
    temporary = file.with_name(f".{file.name}.{uuid.uuid4().hex}{PARTIAL}")
    try:
        shutil.copyfile(file, temporary)
        blank(array, temporary, {(line - first) // array.inner[1] for line in lines}, axis=1)
        temporary.replace(file)
    except (Damaged, OSError) as error:
        temporary.unlink(missing_ok=True)
        if isinstance(error, OSError) and error.errno != errno.EIO:
            raise
        file.unlink()  # nothing in it can be read: no file reads as zeros too
    sync_directory(file.parent)


def _forget(cube: Description, name: str) -> None:
    """What is not known of lines has its fill value. The rest of the chunk cannot be read either."""
    file = cube.path / name
    array = next(array for array in cube.arrays.values() if array.folder in file.parents)
    if file.exists():
        os.rename(file, file.with_name(file.name + DAMAGED))
    metadata = _Root(cube).array(array.folder.name)
    value = np.array(metadata["fill_value"], metadata["data_type"])
    write_durably(file, encode(array, np.full(array.chunk, value).tobytes()))


class _Root:
    """The metadata in the root, to be changed and written. What it says last is what readers see."""

    def __init__(self, cube: Description) -> None:
        self._cube = cube

    def _read(self) -> dict[str, Any]:
        return json.loads((self._cube.path / METADATA).read_bytes())

    def _write(self, root: dict[str, Any]) -> None:
        write_durably(self._cube.path / METADATA, json.dumps(root, indent=2).encode())

    def array(self, name: str) -> dict[str, Any]:
        """What it says of an array."""
        return self._read()["consolidated_metadata"]["metadata"][name]

    def write_array(self, name: str) -> None:
        """Write the array's own file."""
        write_durably(self._cube.path / name / METADATA, json.dumps(self.array(name), indent=2).encode())

    def count(self, status: NDArray[np.uint8], lost: Mapping[int, str] | None = None) -> None:
        """Write how many lines there are, and why some are missing."""
        root = self._read()
        attributes = root["attributes"]
        attributes["missing"] = {
            **attributes.get("missing", {}),
            **{str(line): why for line, why in (lost or {}).items()},
        }
        self._conclude(attributes, status)
        self._write(root)

    def close(self, status: NDArray[np.uint8], lines: int) -> None:
        """What the writer's ``close`` would have done: cut every array to the lines reached, each its own file, then the root."""
        root = self._read()
        arrays = root["consolidated_metadata"]["metadata"]
        documents = {f"{name}/{METADATA}": array for name, array in arrays.items()}
        set_lines(documents, lines)
        for key, document in documents.items():
            write_durably(self._cube.path / key, json.dumps(document, indent=2).encode())
        self._conclude(root["attributes"], status)
        acquisition = root["attributes"]["acquisition"]
        acquisition["finished"] = acquisition.get("finished") or acquisition["repaired"]
        self._write(root)

    def _conclude(self, attributes: dict[str, Any], status: NDArray[np.uint8]) -> None:
        reached = np.flatnonzero(status)
        lines = int(reached[-1]) + 1 if reached.size else 0
        attributes["complete"] = lines == self._cube.planned
        attributes["acquisition"] = {
            **attributes.get("acquisition", {}),
            "lines_reached": lines,
            "lines_stored": int(np.count_nonzero(status == LineStatus.STORED)),
            "lines_missing": int(np.count_nonzero(status == LineStatus.MISSING)),
            "repaired": datetime.now(UTC).isoformat(timespec="milliseconds"),
        }


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
    sync_directory(path.parent)


def line_ranges(lines: Iterable[int]) -> str:
    """Lines as people read them: ``3, 8 to 15``."""
    found: list[list[int]] = []
    for line in sorted(lines):
        if found and line == found[-1][1] + 1:
            found[-1][1] = line
        else:
            found.append([line, line])
    return ", ".join(f"{first}" if first == last else f"{first} to {last}" for first, last in found)
