"""Is a cube of the test pattern what the mirror showed, pixel by pixel?"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import scanhsi
from scanhsi.cube import LineStatus
from scanhsi_sim.scenes.testpattern import expected

BLOCK = 16


def wrong_lines(path: Path) -> list[int]:
    """Stored lines of which any pixel differs from the test pattern at that line's mirror step."""
    cube = scanhsi.open_cube(path)
    bits = 8 if cube["cube"].dtype == np.uint8 else 12
    status, steps = cube["status"].values, cube["mirror_step"].values
    wrong: list[int] = []
    for first in range(0, cube.sizes["line"], BLOCK):
        block = cube["cube"].isel(line=slice(first, first + BLOCK)).values
        for row in range(block.shape[1]):
            line = first + row
            if status[line] == LineStatus.STORED:
                truth = expected(int(steps[line]), (block.shape[0], block.shape[2]), bits=bits)
                if not np.array_equal(block[:, row], truth):
                    wrong.append(line)
    return wrong
