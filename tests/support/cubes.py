"""Small cubes whose pixels say where they belong."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanhsi.cube.layout import CubeSpec
from scanhsi.cube.records import STAGES, LineRecords
from scanhsi.cube.sink import LineSink
from scanhsi.cube.writer import CubeWriter


def frame(spec: CubeSpec, line: int) -> NDArray[Any]:
    """Pixels (band, sample) of a line: different in every line, never all zero, from the line number alone."""
    rng = np.random.default_rng(line)
    return rng.integers(1, 2**spec.significant_bits, (spec.bands, spec.samples), np.uint16).astype(spec.dtype)


def whole(spec: CubeSpec, lines: int) -> NDArray[Any]:
    """Pixels (band, line, sample) of the first lines."""
    return np.stack([frame(spec, line) for line in range(lines)], axis=1)


def take_line(records: LineRecords, line: int) -> None:
    """What an engine notes of a line before it appends it."""
    for number, stage in enumerate(STAGES):
        if stage not in ("stored", "first_byte"):
            records.stamps[stage][line] = line * 1_000_000 + number
    records.mirror_step[line] = 100 + 2 * line
    records.mirror_angle_rad[line] = 1e-3 * line
    records.frame_id[line] = 7 + line
    records.device_ns[line] = 10_000 * line
    records.smeared[line] = line % 3 == 1


async def feed(
    sink: LineSink, spec: CubeSpec, records: LineRecords, lines: range, missing: Mapping[int, str]
) -> list[range]:
    """Append lines as an engine does; the ranges that were returned."""
    named: list[range] = []
    for line in lines:
        if line in missing:
            records.mark_missing(line, missing[line])
        else:
            buffer = sink.buffer(line)
            if buffer is not None:
                buffer[:] = frame(spec, line)
            take_line(records, line)
        named.append(await sink.append(line))
    return named


async def write_cube(
    path: Path | str,
    spec: CubeSpec,
    *,
    reach: int | None = None,
    missing: Mapping[int, str] | None = None,
    lines_per_shard: int | None = None,
    clock_offset_ns: int | None = None,
) -> LineRecords:
    """Write a cube with the first ``reach`` lines; returns its records."""
    records = LineRecords(spec.lines)
    writer = CubeWriter(path, spec, lines_per_shard=lines_per_shard, clock_offset_ns=clock_offset_ns)
    await writer.open(records)
    try:
        await feed(writer, spec, records, range(spec.lines if reach is None else reach), missing or {})
        await writer.flush()
    finally:
        await writer.close()
    return records
