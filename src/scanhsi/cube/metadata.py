"""The ``zarr.json`` files of a cube, as documents: made once by zarr-python, changed here, written by whoever owns the destination.

Readers that know consolidated metadata take all of it from the root, which is replaced whole: they see the old sizes or the new.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import zarr
from pydantic_core import to_json
from zarr.abc.buffer import Buffer
from zarr.storage import MemoryStore

from scanhsi.cube.conventions import root_attributes
from scanhsi.cube.encoding import Codec, codecs_of
from scanhsi.cube.layout import (
    DIMENSIONS,
    FORMAT,
    RECORDS,
    STATUS,
    WAVELENGTH_ATTRIBUTES,
    CubeSpec,
    Layout,
    LineVariable,
    cube_attributes,
)
from scanhsi.cube.quicklook import QuicklookScale

ROOT: Final = "zarr.json"

_ALONG_LINES: Final = ("line", "quicklook_line")

Documents = dict[str, dict[str, Any]]
"""Key -> document, of the group and of each array."""


def new_cube(
    spec: CubeSpec, layout: Layout, codec: Codec, attributes: Mapping[str, Any]
) -> tuple[Documents, dict[str, bytes]]:
    """The documents of an empty cube of the planned size, and its other files (wavelengths)."""
    files: dict[str, Buffer] = {}
    stored = spec.stored
    head = {**root_attributes(_pitch_mm(stored)), "scanhsi_format": FORMAT, **spec.attributes, **attributes}
    group = zarr.create_group(MemoryStore(files), attributes={"missing": {}, **head, "complete": False})
    if stored.wavelength_nm is not None:
        group.create_array(
            "wavelength",
            data=np.asarray(stored.wavelength_nm, np.float64),
            chunks=(stored.bands,),
            compressors=None,
            dimension_names=("band",),
            attributes=dict(WAVELENGTH_ATTRIBUTES),
        )
    for coordinate in stored.coordinates:
        group.create_array(
            coordinate.name,
            data=coordinate.values,
            chunks=coordinate.values.shape,
            compressors=None,
            dimension_names=coordinate.dims,
            attributes=dict(coordinate.attributes),
        )
    for variable in (*RECORDS, STATUS):
        _create_line_array(group, variable, spec.lines, layout.lines_per_shard)
    group.create_array(
        "cube",
        shape=stored.shape,
        dtype=np.dtype(stored.dtype),
        chunks=layout.chunk,
        shards=layout.shard,
        compressors=codecs_of(codec, np.dtype(stored.dtype).itemsize),
        fill_value=0,
        dimension_names=DIMENSIONS,
        attributes=cube_attributes(stored),
    )
    _create_quicklook(group, spec, layout)
    contents = {key: value.to_bytes() for key, value in files.items()}
    documents: Documents = {key: json.loads(contents.pop(key)) for key in list(contents) if key.endswith(ROOT)}
    return documents, contents


def _pitch_mm(spec: CubeSpec) -> tuple[float, float] | None:
    """Distance of lines and of samples of a rectified cube."""
    places = {coordinate.name: coordinate.values for coordinate in spec.coordinates if coordinate.values.ndim == 1}
    if "x" not in places or "y" not in places or min(len(places["x"]), len(places["y"])) < 2:
        return None
    along_x, along_y = (np.diff(places[name]) for name in ("x", "y"))
    even = all(np.allclose(steps, steps[0], rtol=1e-6) for steps in (along_x, along_y))
    return (abs(float(along_y[0])), abs(float(along_x[0]))) if even else None


def _create_line_array(group: zarr.Group, variable: LineVariable, lines: int, lines_per_shard: int) -> None:
    group.create_array(
        variable.name,
        shape=(lines,),
        dtype=variable.dtype,
        chunks=(lines_per_shard,),
        compressors=None,
        fill_value=variable.fill,
        dimension_names=("line",),
        attributes=dict(variable.attributes),
    )


def _create_quicklook(group: zarr.Group, spec: CubeSpec, layout: Layout) -> None:
    if spec.quicklook is None:
        return
    scale = QuicklookScale.choose(layout.lines_per_shard, spec.binning)
    channels = len(spec.quicklook.channels)
    samples = spec.stored.samples
    group.create_array(
        "quicklook",
        shape=(channels, *scale.shape(spec.lines, samples)),
        dtype="uint16",
        chunks=(channels, *scale.shape(layout.lines_per_shard, samples)),
        compressors=None,
        fill_value=0,
        dimension_names=("channel", "quicklook_line", "quicklook_sample"),
        attributes={
            "long_name": "picture of the cube at a smaller scale",
            "units": "1",
            "channels": list(spec.quicklook.channels),
            "comment": spec.quicklook.note,
            "lines_per_pixel": scale.lines,
            "samples_per_pixel": scale.samples,
        },
    )


def line_axes(documents: Documents) -> list[tuple[str, int]]:
    """(array, axis) of the arrays that grow with the lines."""
    axes: list[tuple[str, int]] = []
    for key, document in documents.items():
        names = document.get("dimension_names") or ()
        axes += [(key.removesuffix(f"/{ROOT}"), axis) for axis, name in enumerate(names) if name in _ALONG_LINES]
    return axes


def set_lines(documents: Documents, lines: int) -> None:
    """Give every array so many lines."""
    for name, axis in line_axes(documents):
        document = documents[f"{name}/{ROOT}"]
        document["shape"][axis] = -(-lines // document["attributes"].get("lines_per_pixel", 1))


def encoded(documents: Documents) -> dict[str, bytes]:
    """The files of the documents; the root, which holds a copy of all others, is the last one."""
    arrays = {key: document for key, document in documents.items() if key != ROOT}
    files = {key: _encode(document) for key, document in arrays.items()}
    names = {key.removesuffix(f"/{ROOT}"): document for key, document in sorted(arrays.items())}
    consolidated = {"kind": "inline", "must_understand": False, "metadata": names}
    files[ROOT] = _encode({**documents[ROOT], "consolidated_metadata": consolidated})
    return files


def decoded(root: bytes) -> Documents:
    """The documents of a cube from its root.

    Raises:
        ValueError, KeyError, TypeError: It is none.
    """
    document = json.loads(root)
    names = document.pop("consolidated_metadata")["metadata"]
    return {**{f"{name}/{ROOT}": array for name, array in names.items()}, ROOT: document}


def _encode(document: Mapping[str, Any]) -> bytes:
    return to_json(document, indent=2, inf_nan_mode="constants")  # ten times as fast as json, which indents in Python
