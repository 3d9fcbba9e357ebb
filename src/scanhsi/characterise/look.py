"""A few frames at once, straight into memory: for aids that look, change something and look again."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from scanhsi.calibration.frames import frames_of
from scanhsi.clock import run_blocking
from scanhsi.cube.reader import open_cube

if TYPE_CHECKING:
    from scanhsi.characterise.station import Scans


async def look(imager: Scans, *, exposure_s: float, frames: int = 1, step: int | None = None) -> NDArray[np.uint16]:
    """Take frames with the mirror at rest.

    Args:
        imager: The instrument.
        exposure_s: Exposure time.
        frames: How many.
        step: Where the mirror stands; None is straight ahead.

    Returns:
        (frame, band, sample) counts.

    Raises:
        ScanFailed, OutOfRange: As scans do.
    """
    start = imager.instrument.config.geometry.normal_step if step is None else step
    plan = imager.default_plan(
        lines=frames, step=0, start=start, exposure_s=exposure_s, mode="stepped", look_ahead=None
    )
    with tempfile.TemporaryDirectory(prefix="scanhsi-") as folder:
        path = Path(folder) / "look.zarr"
        await imager.scan(plan, path)
        return await run_blocking(0.0, _read, path)


def _read(path: Path) -> NDArray[np.uint16]:
    return np.stack([frame.astype(np.uint16) for frame in frames_of(open_cube(path, chunks=None), str(path))])
