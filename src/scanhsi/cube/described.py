"""What a cube says of itself: its metadata files, compared with one another."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal, cast

from scanhsi.cube.layout import DIMENSIONS, FORMAT, STATUS
from scanhsi.cube.location import locate
from scanhsi.cube.pieces import ArrayFiles
from scanhsi.devices.errors import CubeError, NotACube

METADATA: Final = "zarr.json"

_LINE: Final = [DIMENSIONS[1]]


@dataclass(frozen=True, slots=True)
class Problem:
    """Something that is not as the cube says.

    Attributes:
        file: Where, relative to the cube.
        reason: What is wrong with it.
        kind: What it touches.
        lines: Lines that cannot be trusted because of it; empty where none is touched.
    """

    file: str
    reason: str
    kind: Literal["pixels", "records", "status", "metadata"]
    lines: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class Description:
    """Metadata of a cube.

    Attributes:
        path: Of the cube.
        attributes: Of the group.
        folders: Of everything the root names, groups too.
        arrays: By name, as the root describes them.
        line_arrays: Those of them with one value a line, but the status.
        problems: Where the arrays' own files disagree with the root.
        torn_close: The arrays were being cut when the writer was killed: some are shorter than the root says.
    """

    path: Path
    attributes: Mapping[str, Any]
    folders: tuple[Path, ...]
    arrays: Mapping[str, ArrayFiles]
    line_arrays: tuple[ArrayFiles, ...]
    problems: tuple[Problem, ...]
    torn_close: bool

    @property
    def acquisition(self) -> Mapping[str, Any]:
        """When and how far it was taken."""
        return _mapping(self.attributes.get("acquisition"))

    @property
    def planned(self) -> int:
        """Lines of the plan."""
        planned = self.acquisition.get("lines_planned")
        return planned if isinstance(planned, int) else self.arrays["cube"].shape[1]

    @property
    def missing_reasons(self) -> dict[int, str]:
        """Line -> why it is missing; also of lines whose status was never written."""
        return {int(line): str(reason) for line, reason in _mapping(self.attributes.get("missing")).items()}

    def name(self, file: Path) -> str:
        """A file as people are told it: relative to the cube."""
        return file.relative_to(self.path).as_posix()


def folder_of(place: str | Path) -> Path:
    """The folder of a cube that is to be checked.

    Raises:
        CubeError: It is in an object store.
    """
    path = locate(place).path
    if path is None:
        raise CubeError(
            f"{place} is in an object store; only cubes in a folder can be verified.", hint="a copy on a disk"
        )
    return path


def describe(path: Path) -> Description:
    """Read the metadata of a cube.

    Raises:
        NotACube: There is no cube.
        CubeError: The metadata is damaged, cannot be read, or is of a newer scanhsi.
    """
    root = _root(path)
    attributes = _mapping(root.get("attributes"))
    version = attributes.get("scanhsi_format")
    if not isinstance(version, int):
        raise NotACube(f"{path} is a Zarr group, but scanhsi did not write it.")
    if version > FORMAT:
        raise CubeError(f"{path} has cube format {version}; this scanhsi reads up to {FORMAT}.", hint="a newer scanhsi")
    nodes = {name: _mapping(node) for name, node in _mapping(_consolidated(root)).items()}
    found = {name: node for name, node in nodes.items() if node.get("node_type") == "array"}
    arrays = {name: ArrayFiles.of(path / name, node) for name, node in found.items()}
    lines = [name for name, node in found.items() if node.get("dimension_names") == _LINE and name != STATUS.name]
    _refuse_unknown(path, arrays, lines)
    problems, torn = _compare(path, found)
    return Description(
        path,
        attributes,
        tuple(path / name for name in nodes),
        arrays,
        tuple(arrays[name] for name in lines),
        tuple(problems),
        torn,
    )


def _root(path: Path) -> Mapping[str, Any]:
    if not path.exists():
        raise NotACube(f"there is no {path}.")
    if not path.is_dir():
        raise NotACube(f"{path} is a file; a cube is a folder, conventionally *.zarr.")
    if not (path / METADATA).exists():
        raise NotACube(f"{path} is a folder, but no Zarr group.")
    root = _read(path / METADATA)
    if isinstance(root, str):
        raise CubeError(f"{path / METADATA} {root}.")
    return root


def _consolidated(root: Mapping[str, Any]) -> Any:
    return _mapping(root.get("consolidated_metadata")).get("metadata")


def _refuse_unknown(path: Path, arrays: Mapping[str, ArrayFiles], lines: Iterable[str]) -> None:
    for name in ("cube", STATUS.name, *lines):
        if name not in arrays:
            raise CubeError(f"{path} lacks its array {name!r}: the cube is damaged.")
        if unknown := arrays[name].unknown_codecs:
            raise CubeError(f"{path / name} is stored with {', '.join(sorted(unknown))}, which cannot be checked here.")


def _compare(path: Path, found: Mapping[str, Mapping[str, Any]]) -> tuple[list[Problem], bool]:
    """What the arrays say themselves against what the root says of them; whether some are shorter than that."""
    problems: list[Problem] = []
    torn = False
    for name, told in found.items():
        own = _read(path / name / METADATA)
        if isinstance(own, str):
            problems.append(Problem(f"{name}/{METADATA}", own, "metadata"))
        elif own.get("shape") != told.get("shape"):
            torn = True
        elif any(own.get(key) != told.get(key) for key in ("data_type", "chunk_grid", "codecs", "fill_value")):
            problems.append(Problem(f"{name}/{METADATA}", "does not say what the root says of this array", "metadata"))
    return problems, torn


def _read(file: Path) -> Mapping[str, Any] | str:
    """A metadata file, or what is wrong with it."""
    try:
        value = json.loads(file.read_bytes())
    except FileNotFoundError:
        return "is not there"
    except OSError as error:
        return f"cannot be read: {error.strerror}"
    except ValueError:
        return "is damaged: no JSON"
    return cast("dict[str, Any]", value) if isinstance(value, dict) else "is damaged: no JSON object"


def _mapping(value: Any) -> Mapping[str, Any]:
    return cast("dict[str, Any]", value) if isinstance(value, dict) else {}
