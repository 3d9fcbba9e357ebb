"""An open instrument outlives the loss of its devices: what was lost is opened anew for the next scan."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest

import scanhsi
from scanhsi.clock import now_ns, run_virtual
from scanhsi.devices import CameraSettings
from scanhsi.devices.errors import DeviceLost, DeviceNotFound, ScanFailed
from scanhsi.instrument import InstrumentConfig, load_instrument
from scanhsi.testing.faults import FaultPlan, Faults
from scanhsi.testing.instrument import with_faults
from scanhsi.testing.witness import Witness
from support.small import SMALL

AWAY_S = 300.0
LINES = 20
UNPLUGGED = {"camera": ("camera unplugged", 8), "actuator": ("actuator unplugged", 11)}


def failing(device: str, witness: Witness | None = None, **settings: Any) -> InstrumentConfig:
    """The simulated instrument, a device of which is unplugged in the first scan, and back so much later."""
    kind, nth = UNPLUGGED[device]
    plan = FaultPlan.model_validate({"faults": [{"kind": kind, "nth": nth, "for_s": AWAY_S}]})
    return with_faults(load_instrument("sensors2019", {**SMALL, **settings}), Faults(plan, now_ns), witness)


async def lose(hsi: scanhsi.Imager, device: str, on_fault: str = "skip") -> ScanFailed:
    plan = hsi.default_plan(lines=LINES, on_fault=on_fault, recover_within="5 s")
    with pytest.raises(ScanFailed) as failed:
        await hsi.scan(plan, None)
    assert hsi.lost.keys() == {device}
    return failed.value


async def sleep_until_back() -> None:
    await asyncio.sleep(AWAY_S)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Pixels of a scan in which nothing is lost."""
    path = tmp_path_factory.mktemp("whole") / "cube.zarr"

    async def main() -> None:
        async with scanhsi.open_instrument(load_instrument("sensors2019", SMALL)) as hsi:
            await hsi.scan(hsi.default_plan(lines=LINES), path)

    run_virtual(main())
    return scanhsi.open_cube(path)["cube"].values


@pytest.mark.parametrize("on_fault", ["skip", "retry"])
@pytest.mark.parametrize("device", ["camera", "actuator"])
def test_the_next_scan_opens_what_was_lost(device: str, on_fault: str, tmp_path: Path, whole: Any) -> None:
    """Also what the recovery of a scan gave up; every pixel as if nothing had happened."""

    async def main() -> scanhsi.ScanReport:
        async with scanhsi.open_instrument(failing(device)) as hsi:
            assert hsi.lost == {}
            failed = await lose(hsi, device, on_fault)
            assert failed.lost.keys() == {device}
            assert device in hsi.lost[device]
            await sleep_until_back()
            report = await hsi.scan(hsi.default_plan(lines=LINES), tmp_path / "cube.zarr")
            assert hsi.lost == {}
            return report

    report = run_virtual(main())
    assert (report.stored, report.missing, report.incidents) == (LINES, 0, ())
    assert (scanhsi.open_cube(tmp_path / "cube.zarr")["cube"].values == whole).all()


@pytest.mark.parametrize("on_fault", ["skip", "retry"])
@pytest.mark.parametrize("device", ["camera", "actuator"])
def test_while_it_is_away_each_try_says_so_at_once(device: str, on_fault: str, tmp_path: Path) -> None:
    async def main() -> None:
        async with scanhsi.open_instrument(failing(device)) as hsi:
            await lose(hsi, device, on_fault)
            began_ns = now_ns()
            for attempt in (
                hsi.scan(hsi.default_plan(lines=LINES), tmp_path / "cube.zarr"),
                hsi.live(lambda line, pixels, records: None),
                hsi.reopen(),
            ):
                with pytest.raises(
                    DeviceNotFound, match=rf"{device} simulated bench, connect: .*Try: plug it in"
                ) as away:
                    await attempt
                assert hsi.lost == {device: str(away.value)}
            assert now_ns() - began_ns < 1e9
            assert not (tmp_path / "cube.zarr").exists()

    run_virtual(main())


def test_opening_anew_moves_nothing_and_the_scan_homes() -> None:
    witness = Witness()

    async def main() -> None:
        async with scanhsi.open_instrument(failing("actuator", witness)) as hsi:
            failed = await lose(hsi, "actuator")
            assert failed.unsafe, "nobody knew whether it moved"
            await sleep_until_back()
            witness.moved = False
            await hsi.reopen()
            assert (hsi.lost, hsi.actuator.homed, witness.moved) == ({}, False, False)
            await hsi.scan(hsi.default_plan(lines=LINES), None)
            assert hsi.actuator.homed
            assert witness.moved

    run_virtual(main())


@pytest.mark.parametrize("device", ["camera", "actuator"])
def test_one_that_went_with_nobody_looking_is_back_for_the_first_scan(device: str, tmp_path: Path) -> None:
    kind, _ = UNPLUGGED[device]
    plan = FaultPlan.model_validate({"faults": [{"kind": kind, "nth": 0, "for_s": AWAY_S}]})
    config = with_faults(load_instrument("sensors2019", SMALL), Faults(plan, now_ns))

    async def main() -> None:
        async with scanhsi.open_instrument(config) as hsi:
            with pytest.raises(DeviceLost):
                await (hsi.camera.configure(CameraSettings(0.02)) if device == "camera" else hsi.actuator.home())
            assert hsi.lost == {}, "nobody was told"
            with pytest.raises(DeviceNotFound):
                await hsi.scan(hsi.default_plan(lines=LINES), tmp_path / "cube.zarr")
            assert not (tmp_path / "cube.zarr").exists()
            await sleep_until_back()
            assert (await hsi.scan(hsi.default_plan(lines=LINES), tmp_path / "cube.zarr")).missing == 0

    run_virtual(main())


def test_a_device_that_was_used_directly() -> None:
    async def main() -> None:
        async with scanhsi.open_instrument(failing("actuator")) as hsi:
            await hsi.actuator.home()
            for step in range(10):
                await hsi.actuator.move_to(step)
            with pytest.raises(DeviceLost) as lost:
                await hsi.actuator.move_to(20)
            hsi.note_lost(lost.value)
            assert hsi.lost.keys() == {"actuator"}
            await sleep_until_back()
            await hsi.reopen("actuator")
            await hsi.actuator.home()
            assert (await hsi.actuator.move_to(5)).step == 5

    run_virtual(main())


def test_a_camera_that_looks_at_something_else_by_now_is_still_the_same() -> None:
    async def main() -> None:
        async with scanhsi.open_instrument(failing("camera")) as hsi:
            await hsi.camera.show("white")  # pyright: ignore[reportAttributeAccessIssue] simulated ones do
            await lose(hsi, "camera", "retry")
            await sleep_until_back()
            assert (await hsi.scan(hsi.default_plan(lines=LINES), None)).missing == 0

    run_virtual(main())
