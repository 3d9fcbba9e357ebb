"""What a crash leaves beside the files of a cube: temporary files of every writer we know, chunks that nothing names."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from scanhsi.cube.described import METADATA
from scanhsi.cube.pieces import ArrayFiles

_TEMPORARY: Final = (
    (re.compile(r"\.partial$"), "temporary file of a writer that was killed"),  # scanhsi, zarr-python
    (re.compile(r"\.__tmp$|\.__tmp\."), "temporary file of a writer that was killed"),
    (re.compile(r"\.__lock$"), "temporary file of tensorstore"),
    (re.compile(r"#\d+$"), "temporary file of obstore"),
)


@dataclass(frozen=True, slots=True)
class Leftover:
    """A file, or folder, that no reader asks for.

    Attributes:
        path: Of it.
        what: Where it comes from.
        size_bytes: Of it, with all that is in it.
        ours: Whether it is known to be a leftover, so that ``repair`` may remove it. Files of unknown origin are told, and stay.
    """

    path: Path
    what: str
    size_bytes: int
    ours: bool = True


def find_leftovers(cube: Path, folders: Iterable[Path], arrays: Iterable[ArrayFiles]) -> list[Leftover]:
    """What is in a cube, and beside it under a temporary name of it, that is no part of it.

    Args:
        cube: The cube.
        folders: Of its arrays and groups.
        arrays: All of them.

    Raises:
        OSError: The folder cannot be listed.
    """
    grids = {array.folder: array for array in arrays}
    metadata = {folder / METADATA for folder in (cube, *folders)}
    inside = [file for file in _files(cube) if file not in metadata]
    return [*_beside(cube), *(found for file in inside if (found := _leftover(file, grids)))]


def _beside(cube: Path) -> Iterator[Leftover]:
    """Cubes of this name that were killed while they were being created: they never held a pixel."""
    name = re.compile(rf"\.{re.escape(cube.name)}\.[0-9a-f]{{32}}\.partial")
    for path in sorted(cube.absolute().parent.iterdir()):
        if name.fullmatch(path.name):
            size = sum(file.lstat().st_size for file in _files(path)) if path.is_dir() else path.lstat().st_size
            yield Leftover(path, "cube that was killed while it was being created", size)


def _files(folder: Path) -> Iterator[Path]:
    return (path for path in sorted(folder.rglob("*")) if path.is_symlink() or not path.is_dir())


def _leftover(file: Path, grids: dict[Path, ArrayFiles]) -> Leftover | None:
    size = file.lstat().st_size
    for pattern, what in _TEMPORARY:
        if pattern.search(file.name):
            return Leftover(file, what, size)
    array = next((grids[folder] for folder in file.parents if folder in grids), None)
    place = _place(array, file) if array is not None else None
    if array is None or place is None:
        return Leftover(file, "no part of the cube", size, ours=False)
    if all(number < count for number, count in zip(place, array.grid(), strict=True)):
        return None
    return Leftover(file, "chunk beyond the end of its array", size)


def _place(array: ArrayFiles, file: Path) -> tuple[int, ...] | None:
    """Place in the grid of a chunk file, by its name."""
    first, *rest = file.relative_to(array.folder).as_posix().split(array.separator)
    if first != "c" or len(rest) != len(array.shape) or not all(part.isdecimal() for part in rest):
        return None
    return tuple(map(int, rest))
