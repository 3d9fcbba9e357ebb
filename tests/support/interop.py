"""Cubes for readers that are not ours, one for every way the writer can store pixels."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from scanhsi import clock
from scanhsi.cube.layout import CubeSpec
from scanhsi.cube.records import LineRecords
from scanhsi.cube.shards import Codec
from scanhsi.cube.writer import CubeWriter
from support.cubes import feed, whole

CODECS: tuple[Any, ...] = get_args(Codec)
"""All that the writer offers: a new one is tested from the day it appears."""

_MISSING = {3: "lost"}


@dataclass(frozen=True)
class Written:
    """A cube, and what must be found in it."""

    path: Path
    pixels: NDArray[np.uint16]
    wavelength: NDArray[np.float64]
    status: NDArray[np.uint8]
    time_ns: NDArray[np.int64]


def write_for_all(path: Path, codec: Any) -> Written:
    """A cube whose shards are padded in band and sample, with a lost line, closed two lines early."""
    wavelength = np.linspace(400, 1000, 53)
    spec = CubeSpec(13, 53, 811, "uint16", 12, {"simulated": True}, wavelength)
    records = LineRecords(spec.lines)
    offset_ns = 1_800_000_000_000_000_123  # more digits than a double holds

    async def main() -> None:
        writer = CubeWriter(path, spec, lines_per_shard=4, codec=codec, clock_offset_ns=offset_ns)
        await writer.open(records)
        await feed(writer, spec, records, range(11), _MISSING)
        await writer.close()

    clock.run(main(), virtual=True)
    pixels = whole(spec, 11)
    pixels[:, list(_MISSING)] = 0
    status = np.ones(11, np.uint8)
    status[list(_MISSING)] = 2
    start = records.stamps["exposure_start"][:11]
    time_ns = np.where(status == 1, start + offset_ns, start)
    return Written(path, pixels, wavelength, status, time_ns)
