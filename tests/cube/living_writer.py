"""Writes a cube slowly, for those who read it meanwhile: ``python living_writer.py CUBE``."""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from scanhsi import clock
from scanhsi.cube.layout import CubeSpec
from scanhsi.cube.records import LineRecords
from scanhsi.cube.writer import CubeWriter
from support.cubes import feed

SPEC = CubeSpec(120, 24, 50, "uint16", 12)
REACH = 110
MISSING = {line: f"reason {line}" for line in range(5, REACH, 11)}


async def main(path: Path) -> None:
    records = LineRecords(SPEC.lines)
    writer = CubeWriter(path, SPEC, lines_per_shard=8)
    await writer.open(records)
    for line in range(REACH):
        await feed(writer, SPEC, records, range(line, line + 1), MISSING)
        await asyncio.sleep(0.004)
        if line % 5 == 4:
            await writer.flush()  # shards that are not full are replaced, again and again
    await writer.close()


if __name__ == "__main__":
    clock.run(main(Path(sys.argv[1])))
