"""Cubes to export, and the programs that open what was exported."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from scanhsi import clock
from scanhsi.cube import CubeSpec, CubeWriter
from scanhsi.cube.records import LineRecords
from support.cubes import take_line


def needed(program: str, package: str) -> str:
    """Path of a program. Missing: a failure in CI, else a skip that says what to install."""
    found = shutil.which(program)
    if found is None:
        (pytest.fail if os.environ.get("CI") else pytest.skip)(f"{program} is missing: apt install {package}")
    return found


def octave(code: str, folder: Path) -> str:
    """Run Octave code in a folder; what it printed."""
    command = [needed("octave-cli", "octave"), "--no-init-file", "--quiet", "--eval", code]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def pixels_of(
    shape: tuple[int, int, int], dtype: str, bits: int | None, seed: int = 0, saturated: float = 0.02
) -> NDArray[Any]:
    """Random pixels (band, line, sample), some of them saturated."""
    rng = np.random.default_rng(seed)
    if bits is None:
        return rng.normal(0.5, 0.3, shape).astype(dtype)
    pixels = rng.integers(0, 2**bits, shape, np.uint32)
    pixels[rng.random(shape) < saturated] = 2**bits - 1
    return pixels.astype(dtype)


def make_cube(
    path: Path,
    pixels: NDArray[Any],
    *,
    bits: int | None = 12,
    missing: Mapping[int, str] | None = None,
    planned: int | None = None,
    lines_per_shard: int | None = 4,
    attributes: Mapping[str, Any] | None = None,
    wavelength_nm: NDArray[np.float64] | None = None,
) -> Path:
    """Write a cube with these pixels (band, line, sample)."""
    bands, lines, samples = pixels.shape
    planned = lines if planned is None else planned
    spec = CubeSpec(planned, bands, samples, pixels.dtype, bits, attributes or {}, wavelength_nm)

    async def write() -> None:
        records = LineRecords(planned)
        writer = CubeWriter(path, spec, lines_per_shard=lines_per_shard, clock_offset_ns=1_700_000_000_000_000_000)
        await writer.open(records)
        for line in range(lines):
            if missing and line in missing:
                records.mark_missing(line, missing[line])
            else:
                buffer = writer.buffer(line)
                assert buffer is not None
                buffer[:] = pixels[:, line]
                take_line(records, line)
            await writer.append(line)
        await writer.close()

    clock.run(write(), virtual=True)
    return path
