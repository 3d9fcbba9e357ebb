"""What an interrupted cube holds, read back so that a writer can go on where it ended."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import zarr
from numpy.typing import NDArray
from zarr.core.buffer import default_buffer_prototype
from zarr.storage import MemoryStore

from scanhsi.cube.destination import Destination
from scanhsi.cube.encoding import CODECS, Codec
from scanhsi.cube.layout import FORMAT, RECORDS, STATUS, CubeSpec, Layout, LineVariable
from scanhsi.cube.metadata import ROOT, Documents, decoded, set_lines
from scanhsi.cube.records import NOT_STAMPED, STAGES, Incident, LineRecords, LineStatus
from scanhsi.devices.errors import CubeError, NotACube

_OF_A_SESSION: Final = frozenset({"run", "versions", "devices", "real_time"})
"""Attributes that may differ when a scan is resumed."""


@dataclass(frozen=True, slots=True)
class Interrupted:
    """An interrupted cube.

    Attributes:
        documents: Its metadata.
        layout: Of ``cube``.
        codec: Of ``cube``.
        status: (planned lines,).
        next_line: The first line that is not there.
        clock_offset_ns: Unix time minus loop time of the session that began it.
    """

    documents: Documents
    layout: Layout
    codec: Codec
    status: NDArray[np.uint8]
    next_line: int
    clock_offset_ns: int

    @property
    def attributes(self) -> dict[str, Any]:
        """Of the group."""
        return self.documents[ROOT]["attributes"]

    @property
    def missing(self) -> dict[int, str]:
        """Reasons of the lines that are missing for good. A reason is written before the status: others do not count."""
        reasons: Mapping[str, str] = self.attributes.get("missing", {})
        lost = np.flatnonzero(self.status == LineStatus.MISSING).tolist()
        return {line: reasons.get(str(line), "reason not recorded") for line in lost}


def read_interrupted(destination: Destination, spec: CubeSpec) -> Interrupted:
    """Read what a cube holds and check that ``spec`` is what it was begun with.

    Raises:
        NotACube: There is no cube.
        CubeError: It is complete, or of another plan, or damaged; says which.
    """
    documents = _documents(destination)
    attributes = documents[ROOT]["attributes"]
    name = destination.name
    if attributes.get("complete"):
        raise CubeError(f"{name} is complete: there is nothing to resume.")
    codec, layout = _storage(name, documents)
    _check_same(name, documents, spec, destination.get("wavelength/c/0"))
    set_lines(documents, spec.lines)
    status = _column(destination, STATUS, layout, spec.lines)
    holes = np.flatnonzero(status == LineStatus.NOT_STORED)
    next_line = int(holes[0]) if holes.size else spec.lines
    behind = np.flatnonzero(status[next_line:]) + next_line
    if behind.size:
        raise CubeError(
            f"{name} has no line {next_line}, but lines behind it, up to {behind[-1]}: resuming would write over them.",
            hint="scanhsi verify --repair --mark-unreadable marks them as missing",
        )
    return Interrupted(documents, layout, codec, status, next_line, int(attributes["clock_offset_ns"]))


def load_records(destination: Destination, cube: Interrupted, records: LineRecords, shift_ns: int) -> None:
    """Read the records of the lines that are there.

    Args:
        destination: Of the cube.
        cube: What it holds.
        records: To be filled.
        shift_ns: Clock of the cube minus clock of the running loop, ns.

    Raises:
        CubeError: They are not there, though the status says so.
    """
    there = slice(0, cube.next_line)
    for variable in RECORDS:
        if variable.name == "time":
            continue  # the start of exposure, once more
        column = _column(destination, variable, cube.layout, cube.next_line, required=True)
        stage = variable.name.removesuffix("_ns")
        if stage in STAGES:
            records.stamps[stage][there] = np.where(column == NOT_STAMPED, NOT_STAMPED, column - shift_ns)
        else:
            getattr(records, variable.name)[there] = column
    records.status[there] = cube.status[there]
    records.missing.update(cube.missing)
    records.incidents += [Incident.from_json(told, shift_ns) for told in cube.attributes.get("incidents", ())]


def load_rows(destination: Destination, cube: Interrupted) -> NDArray[Any] | None:
    """Pixels (line, band, sample) of the lines that are there of the shard that is not full; None where there are none.

    Raises:
        CubeError: They cannot be read: the shard is damaged.
    """
    per_shard = cube.layout.lines_per_shard
    shard, lines = divmod(cube.next_line, per_shard)
    if not lines:
        return None
    key = f"cube/c/0/{shard}/0"
    contents = destination.get(key)
    first = cube.next_line - lines
    if contents is None:
        raise CubeError(f"{destination.name} lacks {key}, which holds lines {first} to {cube.next_line - 1}.")
    to_buffer = default_buffer_prototype().buffer.from_bytes
    metadata = json.dumps(cube.documents[f"cube/{ROOT}"]).encode()
    store = MemoryStore({ROOT: to_buffer(metadata), key.removeprefix("cube/"): to_buffer(contents)})
    try:
        array = zarr.open_array(store, mode="r")
        rows = np.asarray(array[:, first : cube.next_line, :])
    except Exception as error:  # what a codec raises for damaged data is its own affair
        raise CubeError(f"{key} of {destination.name} is damaged: {error}", hint="scanhsi verify --repair") from error
    return rows.transpose(1, 0, 2)


def _documents(destination: Destination) -> Documents:
    root = destination.get(ROOT)
    if root is None:
        raise NotACube(f"there is no cube at {destination.name}.")
    try:
        documents = decoded(root)
        version = documents[ROOT]["attributes"]["scanhsi_format"]
    except (ValueError, KeyError, TypeError) as error:
        raise NotACube(f"{destination.name} was not written by scanhsi, or its {ROOT} is damaged.") from error
    if version != FORMAT:
        raise CubeError(f"{destination.name} has cube format {version}; this scanhsi writes {FORMAT}.")
    return documents


def _storage(name: str, documents: Documents) -> tuple[Codec, Layout]:
    codec = documents[ROOT]["attributes"].get("storage", {}).get("codec")
    arrays = [f"{variable.name}/{ROOT}" for variable in (*RECORDS, STATUS)]
    if codec not in CODECS or not documents.keys() >= set(arrays):
        raise CubeError(f"{name} was begun by another version of scanhsi, which must finish it.")
    cube = documents[f"cube/{ROOT}"]
    shard = tuple(cube["chunk_grid"]["configuration"]["chunk_shape"])
    chunk = tuple(cube["codecs"][0]["configuration"]["chunk_shape"])
    return codec, Layout(shard, chunk)


def _check_same(name: str, documents: Documents, spec: CubeSpec, wavelength: bytes | None) -> None:
    """The cube is what ``spec`` describes."""
    attributes, cube = documents[ROOT]["attributes"], documents[f"cube/{ROOT}"]
    stored = spec.stored
    binning = attributes.get("binning", {"bands": 1, "samples": 1})
    pairs: dict[str, tuple[object, object]] = {
        "lines": (attributes.get("acquisition", {}).get("lines_planned"), spec.lines),
        "bands": (cube["shape"][0], stored.bands),
        "samples": (cube["shape"][2], stored.samples),
        "dtype": (cube["data_type"], np.dtype(stored.dtype).name),
        "significant bits": (cube["attributes"].get("significant_bits"), stored.significant_bits),
        "binning": ((binning["bands"], binning["samples"]), (spec.binning.bands, spec.binning.samples)),
        "quicklook": (f"quicklook/{ROOT}" in documents, spec.quicklook is not None),
    }
    asked_nm = None if stored.wavelength_nm is None else np.asarray(stored.wavelength_nm, "<f8").tolist()
    pairs["wavelengths"] = (None if wavelength is None else np.frombuffer(wavelength, "<f8").tolist(), asked_nm)
    for key in sorted(spec.attributes.keys() - _OF_A_SESSION):
        pairs[f"attribute {key!r}"] = (attributes.get(key), _json_like(spec.attributes[key]))
    if differing := [what for what, (there, asked) in pairs.items() if there != asked]:
        there, asked = pairs[differing[0]]
        raise CubeError(
            f"{name} was begun with another {' and '.join(differing)}: {_short(there)} there, {_short(asked)} now. "
            "Nothing was written.",
            hint="the same plan and instrument file, or another output",
        )


def _json_like(value: object) -> object:
    """A value as it comes back from JSON."""
    return json.loads(json.dumps(value))


def _short(value: object) -> str:
    text = str(value)
    return text if len(text) <= 80 else f"{text[:77]}..."


def _column(
    destination: Destination, variable: LineVariable, layout: Layout, lines: int, *, required: bool = False
) -> NDArray[Any]:
    """A per-line array up to a line; ``fill`` where no chunk is, unless that must not be."""
    per_shard = layout.lines_per_shard
    kind = np.dtype(variable.dtype).newbyteorder("<")
    column = np.full(-(-lines // per_shard) * per_shard, variable.fill, kind)
    for shard in range(len(column) // per_shard):
        key = f"{variable.name}/c/{shard}"
        contents = destination.get(key)
        if contents is not None and len(contents) == per_shard * kind.itemsize:
            column[shard * per_shard : (shard + 1) * per_shard] = np.frombuffer(contents, kind)
        elif contents is not None or required:
            raise CubeError(f"{key} of {destination.name} is missing or damaged.", hint="scanhsi verify --repair")
    return column[:lines]
