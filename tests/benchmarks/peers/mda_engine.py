"""pymmcore-plus: a z-stack by its acquisition engine, over Micro-Manager's demo camera and stage, written by its OME-Zarr sink.

The demo camera makes a picture of its own for every snap; with `FastImage` it makes one and gives it again and again.
"""

from __future__ import annotations

from pathlib import Path

import mm_test_adapters
import numpy as np
import useq
import zarr
from pymmcore_plus import CMMCorePlus
from work import SHAPE, Watch, Work

STEP_UM = 0.1


def scan(work: Work, watch: Watch) -> np.ndarray | None:
    core = _core()
    # ranges are closed: n lines span n - 1 steps
    plan = useq.MDASequence(z_plan=useq.ZRangeAround(range=(work.lines - 1) * STEP_UM, step=STEP_UM))
    core.mda.events.frameReady.connect(watch.line_over)
    with watch.running():
        core.run_mda(plan, output=work.store, block=True)
    return None if work.store is None else _stored(work.store)


def scan_without_engine(work: Work, watch: Watch) -> None:
    """The same devices, asked directly: what stage and camera cost alone. Nothing is stored."""
    core = _core()
    with watch.running():
        for line in range(work.lines):
            core.setZPosition(line * STEP_UM)
            core.waitForDevice(core.getFocusDevice())
            core.snapImage()
            core.getImage()
            watch.line_over()


def _core() -> CMMCorePlus:
    adapters = mm_test_adapters.device_adapter_path()
    core = CMMCorePlus()
    core.setDeviceAdapterSearchPaths([adapters])
    core.loadSystemConfiguration(Path(adapters) / "MMConfig_demo.cfg")
    camera = core.getCameraDevice()
    for name, value in {
        "OnCameraCCDXSize": SHAPE[1],
        "OnCameraCCDYSize": SHAPE[0],
        "PixelType": "16bit",
        "Mode": "Color Test Pattern",
    }.items():
        core.setProperty(camera, name, value)
    core.setExposure(0)
    core.snapImage()  # the picture that it gives from now on: without one it is all zero, and zeros are not stored
    core.setProperty(camera, "FastImage", 1)
    return core


def _stored(path: Path) -> np.ndarray:
    """The full-resolution array of the OME-Zarr, (line, row, column)."""
    group = zarr.open_group(path, mode="r")
    stored = group["0"][:]
    return stored.reshape(-1, *stored.shape[-2:])
