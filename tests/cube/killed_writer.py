"""Writes cubes in children that are killed: ``python killed_writer.py FOLDER SHARD:DELAY_S ...``, one child an argument.

A child is killed so much later than the status of that shard has appeared; shard -1 is before the cube exists.

Children are forked before any thread exists, so that none spends the delay on imports.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from scanhsi import clock
from scanhsi.cube.layout import CubeSpec
from support.cubes import write_cube

SPEC = CubeSpec(60, 64, 100, "uint16", 12)


def main() -> None:
    folder, *moments = sys.argv[1:]
    for number, moment in enumerate(moments):
        shard, delay_s = moment.split(":")
        path = Path(folder) / f"{number}.zarr"
        child = os.fork()
        if child == 0:
            clock.run(write_cube(path, SPEC, lines_per_shard=4))
            os._exit(0)
        while int(shard) >= 0 and not (path / "status/c" / shard).exists():
            time.sleep(0.0002)
        time.sleep(float(delay_s))
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)


if __name__ == "__main__":
    main()
