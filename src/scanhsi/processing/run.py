"""Runs a pipeline over a cube of any size and writes what comes out as a cube."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

import xarray as xr

from scanhsi.cube.layout import WAVELENGTH_MAP_ATTRIBUTES, Coordinate, CubeSpec, choose_layout
from scanhsi.cube.rewrite import Progress, Rewriting, attributes_of, coordinates_of, open_source
from scanhsi.cube.shards import Codec
from scanhsi.processing.pipeline import Pipeline
from scanhsi.processing.saturated import Tops, plateau_in
from scanhsi.processing.signal import Signal
from scanhsi.processing.steps import Step

if TYPE_CHECKING:
    from distributed import Client

_MANY_LINES: Final = 64


def process(
    cube: str | Path,
    output: str | Path,
    steps: Sequence[Step],
    *,
    client: Client | None = None,
    threads: int = 2,
    codec: Codec = "lz4",
    resume: bool = False,
    progress: Progress | None = None,
    storage_options: Mapping[str, str] | None = None,
) -> Pipeline:
    """Process a cube into a new one.

    The new cube has the lines, records and attributes of the old one, and says in ``processing`` what was done, with what. Its
    pixels are float32; nan is what cannot be known. Memory is a few shards a thread, whatever the size of the cube. Where
    `MaskSaturated` comes first and without a level, a plateau below full scale is found and masked; ``saturation`` tells.

    Args:
        cube: Path or URL of the cube.
        output: Folder of the new cube, which must not exist.
        steps: What to do, in order.
        client: A `distributed.Client`: its workers do it, each its own shards. They must see both cubes under the same names.
            None: threads of this process.
        threads: So many, without a cluster.
        codec: Of the new cube.
        resume: Go on with what an interrupted run left at ``output``.
        progress: Told after every shard.
        storage_options: As of `scanhsi.open_cube`.

    Returns:
        The pipeline as it was bound to the cube.

    Raises:
        CalibrationError: A step does not fit the cube; nothing was written.
        NotACube, CubeExists, CubeError: A cube cannot be read or written.
    """
    rewriting, pipeline = work_of(open_source(cube, storage_options), str(cube), Path(output), steps, codec)
    rewriting.run(client=client, threads=threads, resume=resume, progress=progress)
    return pipeline


def work_of(
    source: xr.Dataset, name: str, output: Path, steps: Sequence[Step], codec: Codec, *, lines: int | None = None
) -> tuple[Rewriting, Pipeline]:
    """What is to be done for `process`, and the pipeline that it is done with.

    Args:
        source: The cube, opened without dask.
        name: Of the cube, for the provenance.
        output: Folder of the new cube.
        steps: What to do, in order.
        codec: Of the new cube.
        lines: Of the new cube; as many as the source has by default.
    """
    pipeline = Pipeline(Signal.of(source), steps)
    spec = _spec(source, pipeline, name, lines or source.sizes["line"])
    plateau = plateau_in(pipeline.input, steps)
    rewriting = Rewriting(
        source,
        output,
        spec,
        choose_layout(spec, min(lines_per_shard(source), _MANY_LINES)),
        codec,
        compute=pipeline,
        inspect=None if plateau is None else Tops(plateau.full_scale),
        review=plateau,
    )
    return rewriting, pipeline


def lines_per_shard(source: xr.Dataset) -> int:
    """Of a cube that was opened."""
    encoding = source["cube"].encoding
    return int((encoding.get("shards") or encoding["chunks"])[1])


def _spec(source: xr.Dataset, pipeline: Pipeline, name: str, lines: int) -> CubeSpec:
    signal, attributes = pipeline.output, attributes_of(source)
    coordinates = coordinates_of(source, but=("wavelength_map",))
    if signal.wavelength_map_nm is not None:
        pixels = Coordinate("wavelength_map", ("band", "sample"), signal.wavelength_map_nm, WAVELENGTH_MAP_ATTRIBUTES)
        coordinates = (*coordinates, pixels)
    done = attributes.get("processing", [])
    return CubeSpec(
        lines=lines,
        bands=signal.bands,
        samples=signal.samples,
        dtype=signal.dtype,
        significant_bits=None if signal.dtype.kind == "f" else 8 * signal.dtype.itemsize,
        attributes={**attributes, "processing": [*done, {"step": "read", "source": name}, *pipeline.describe()]},
        wavelength_nm=signal.wavelength_nm,
        pixel_attributes={"long_name": signal.long_name, "units": signal.units},
        coordinates=coordinates,
    )
