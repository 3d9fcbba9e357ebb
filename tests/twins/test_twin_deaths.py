"""What dies in mid-scan: the emulator, the camera, the scanning process. What was stored is right, and the mirror stands."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
from pathlib import Path

import numpy as np
import pytest

import scanhsi
from scanhsi import clock
from scanhsi.cube import LineStatus
from scanhsi.devices.errors import DeviceLost, DeviceTimeout, PositionLost
from scanhsi_sim.twins.rig import TwinRig
from support.exact import wrong_lines
from support.twin_scans import instrument, scan_twin

pytestmark = [pytest.mark.twin, pytest.mark.timeout(180)]


def test_an_emulator_that_dies_ends_the_scan_with_a_partial_cube(tmp_path: Path) -> None:
    async def kill(rig: TwinRig) -> None:
        await asyncio.sleep(3)
        os.kill(rig.stepper.pid, signal.SIGKILL)

    with pytest.raises(scanhsi.ScanFailed) as failed:
        scan_twin({"lines": 300, "exposure": "10 ms", "step": 2, "pixel_format": "Mono8"}, tmp_path / "cube.zarr", kill)
    assert isinstance(failed.value.causes[0], DeviceLost | PositionLost | DeviceTimeout)
    assert "actuator stepper" in str(failed.value)
    check_partial(tmp_path / "cube.zarr", failed.value.stored)


def test_a_camera_that_dies_ends_the_scan_with_a_partial_cube_and_a_mirror_that_stands(tmp_path: Path) -> None:
    moving: list[bool] = []

    async def kill(rig: TwinRig) -> None:
        await asyncio.sleep(3)
        os.kill(rig.camera.pid, signal.SIGKILL)
        await asyncio.sleep(12)
        first = (await rig.stepper.stats())["position"]
        await asyncio.sleep(0.3)
        moving.append((await rig.stepper.stats())["position"] != first)

    async def main() -> float:
        async with TwinRig() as rig, scanhsi.open_instrument(instrument(rig)) as hsi:
            killer = asyncio.ensure_future(kill(rig))
            loop = asyncio.get_running_loop()
            plan = hsi.default_plan(lines=300, exposure="10 ms", step=2, pixel_format="Mono8")
            with pytest.raises(scanhsi.ScanFailed) as failed:
                await hsi.scan(plan, tmp_path / "cube.zarr")
            ended = loop.time()
            assert isinstance(failed.value.causes[0], DeviceLost | DeviceTimeout)
            assert "camera aravis" in str(failed.value)
            check_partial(tmp_path / "cube.zarr", failed.value.stored)
            await killer
            return ended

    clock.run(main())
    assert moving == [False]


SCANNER = """
import sys
import scanhsi
from scanhsi import clock
from scanhsi.instrument import load_instrument

async def main():
    config = load_instrument("twin", {"actuator.port": sys.argv[1], "camera.address": sys.argv[2]})
    async with scanhsi.open_instrument(config) as hsi:
        plan = hsi.default_plan(lines=300, exposure="10 ms", step=2, pixel_format="Mono8")
        await hsi.scan(plan, sys.argv[3], on_progress=lambda told: print(told.stored, flush=True))

clock.run(main())
"""


def test_a_scanning_process_that_is_killed_leaves_a_cube_that_says_what_it_holds(tmp_path: Path) -> None:
    """And both devices can be opened again: the camera gives up the dead controller, the port is free."""
    output = tmp_path / "cube.zarr"

    async def main() -> None:
        async with TwinRig() as rig:
            scanner = await asyncio.create_subprocess_exec(
                sys.executable, "-c", SCANNER, rig.port, rig.camera_address, str(output), stdout=asyncio.subprocess.PIPE
            )
            assert scanner.stdout is not None
            while int(await scanner.stdout.readline()) < 32:
                pass
            scanner.kill()
            await scanner.wait()
            check_partial(output, None)
            async with scanhsi.open_instrument(instrument(rig)) as hsi:
                plan = hsi.default_plan(lines=5, exposure="10 ms", step=2, pixel_format="Mono8")
                assert (await hsi.scan(plan, tmp_path / "again.zarr")).stored == 5

    clock.run(main())


def check_partial(path: Path, stored: int | None) -> None:
    """A partial cube opens, tells how many lines it holds, and every one of them is right."""
    cube = scanhsi.open_cube(path)
    held = int(np.count_nonzero(cube["status"].values == LineStatus.STORED))
    assert 0 < held < 300
    assert cube.attrs["lines_stored"] == held
    assert cube.attrs["lines_planned"] == 300
    assert not cube.attrs.get("complete", False)
    if stored is not None:
        assert held == stored
    assert wrong_lines(path) == []
