"""The real drivers lose their devices in mid-scan, and get them back: every pixel checked."""

from __future__ import annotations

import asyncio
import os
import signal
from pathlib import Path

import pytest

import scanhsi
from scanhsi import clock
from scanhsi.devices.errors import DeviceNotFound
from scanhsi.engine import Progress
from scanhsi.instrument import load_instrument
from scanhsi_sim.twins.camera_twin import CameraTwin, CameraTwinSettings
from scanhsi_sim.twins.rig import TwinRig
from support.exact import wrong_lines

pytestmark = [pytest.mark.twin, pytest.mark.timeout(240)]

LINES = 60


async def scan(rig: TwinRig, output: Path, at_20: asyncio.Event) -> scanhsi.ScanReport:
    """A scan that retries; tells when it has taken 20 lines."""
    config = load_instrument("twin", {"actuator.port": rig.port, "camera.address": rig.camera_address})

    def told(progress: Progress) -> None:
        if progress.taken >= 20:
            at_20.set()

    async with scanhsi.open_instrument(config) as hsi:
        plan = hsi.default_plan(lines=LINES, exposure="10 ms", step=2, pixel_format="Mono8", on_fault="retry")
        return await hsi.scan(plan, output, on_progress=told)


def check(report: scanhsi.ScanReport, output: Path, device: str) -> None:
    assert (report.stored, report.missing) == (LINES, 0), report.missing_reasons
    assert wrong_lines(output) == []
    assert any(device in incident.device and "opened anew" in incident.action for incident in report.incidents)
    assert report.interrupted_s > 1


def test_a_serial_port_is_unplugged_and_plugged_in_again(tmp_path: Path) -> None:
    async def main() -> scanhsi.ScanReport:
        at_20 = asyncio.Event()
        async with TwinRig(scene="testpattern") as rig:
            scanning = asyncio.ensure_future(scan(rig, tmp_path / "cube.zarr", at_20))
            await at_20.wait()
            await rig.stepper.command("unplug")
            await asyncio.sleep(1.0)
            await rig.stepper.command("plug")
            return await scanning

    report = clock.run(main())
    check(report, tmp_path / "cube.zarr", "actuator stepper")
    assert any("homed" in incident.action for incident in report.incidents)


@pytest.mark.soak
def test_a_controller_that_is_reset_is_homed_and_goes_on(tmp_path: Path) -> None:
    async def main() -> scanhsi.ScanReport:
        at_20 = asyncio.Event()
        async with TwinRig(scene="testpattern") as rig:
            scanning = asyncio.ensure_future(scan(rig, tmp_path / "cube.zarr", at_20))
            await at_20.wait()
            await rig.stepper.command("reset")
            return await scanning

    report = clock.run(main())
    assert (report.stored, wrong_lines(tmp_path / "cube.zarr")) == (LINES, [])
    assert "homed" in report.incidents[0].action


@pytest.mark.soak
def test_a_camera_dies_and_is_started_again(tmp_path: Path) -> None:
    async def main() -> scanhsi.ScanReport:
        at_20 = asyncio.Event()
        async with TwinRig(scene="testpattern") as rig:
            scanning = asyncio.ensure_future(scan(rig, tmp_path / "cube.zarr", at_20))
            await at_20.wait()
            os.kill(rig.camera.pid, signal.SIGKILL)
            await asyncio.sleep(3.0)
            settings = CameraTwinSettings(scene="testpattern", mirror_file=rig.stepper.mirror_file)
            async with CameraTwin(settings):
                return await scanning

    check(clock.run(main()), tmp_path / "cube.zarr", "camera aravis")


@pytest.mark.soak
def test_between_two_scans_both_go_and_come_back(tmp_path: Path) -> None:
    """The instrument stays open: while one is away each scan is refused before anything is made, then the next one has it back."""

    async def main() -> None:
        async with TwinRig(scene="testpattern") as rig:
            config = load_instrument("twin", {"actuator.port": rig.port, "camera.address": rig.camera_address})
            async with scanhsi.open_instrument(config) as hsi:
                plan = hsi.default_plan(lines=20, exposure="10 ms", step=2, pixel_format="Mono8")

                async def refused(device: str) -> None:
                    with pytest.raises(DeviceNotFound, match=device):
                        await hsi.scan(plan, tmp_path / "not-made.zarr")
                    assert hsi.lost.keys() == {device}

                async def whole(name: str) -> None:
                    report = await hsi.scan(plan, tmp_path / name)
                    assert (hsi.lost, report.missing, wrong_lines(tmp_path / name)) == ({}, 0, [])

                await whole("before.zarr")
                await rig.stepper.command("unplug")
                await asyncio.sleep(0.5)
                await refused("actuator")
                await rig.stepper.command("plug")
                await whole("plugged-in.zarr")
                await rig.stepper.command("unplug")
                await asyncio.sleep(0.5)
                await rig.stepper.command("plug")
                await whole("unnoticed.zarr")
                os.kill(rig.camera.pid, signal.SIGKILL)
                await refused("camera")
                async with CameraTwin(CameraTwinSettings(scene="testpattern", mirror_file=rig.stepper.mirror_file)):
                    await whole("started-again.zarr")

    clock.run(main())
    assert not (tmp_path / "not-made.zarr").exists()
