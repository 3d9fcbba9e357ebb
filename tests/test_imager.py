"""The Python interface on the simulated instrument, in virtual time."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

import scanhsi
from scanhsi.clock import run_virtual
from scanhsi.devices.errors import CubeExists, DeviceBusy, OutOfRange
from scanhsi.instrument import InstrumentConfig, load_instrument
from scanhsi_sim.scenes.testpattern import decode
from support.small import SMALL


def small() -> InstrumentConfig:
    return load_instrument("sensors2019", SMALL)


@pytest.mark.parametrize("mode", ["sequential", "stepped", "continuous"])
def test_the_modes_give_the_same_cube(mode: str, tmp_path: Path) -> None:
    """Overlap changes when lines are taken, not what they show: the test pattern at each line's step."""

    async def main() -> scanhsi.ScanReport:
        async with scanhsi.open_instrument(small()) as hsi:
            return await hsi.scan(hsi.default_plan(lines=40, mode=mode), tmp_path / "cube.zarr")

    report = run_virtual(main())
    assert (report.stored, report.missing, report.simulated) == (40, 0, True)
    cube = scanhsi.open_cube(tmp_path / "cube.zarr")
    for line in range(40):
        seen = decode(cube["cube"].isel(line=line).values, offset=(500, 1000))
        assert seen.step == int(cube["mirror_step"][line]) % 4096
        assert mode == "continuous" or not seen.moved
    assert cube.attrs["simulated"] is True
    assert cube.attrs["plan"]["mode"] == mode


def test_results_in_virtual_time_are_the_same_every_time() -> None:
    async def main(seed: int) -> scanhsi.ScanReport:
        async with scanhsi.open_instrument("sensors2019", seed=seed) as hsi:
            return await hsi.scan(hsi.default_plan(lines=60, exposure="100 ms", pixel_format="Mono8"), None)

    assert run_virtual(main(1)) == run_virtual(main(1))
    assert run_virtual(main(1)).period_s != run_virtual(main(2)).period_s


@pytest.mark.parametrize(
    ("mode", "least", "most"), [("sequential", 0.747, 0.753), ("stepped", 0.88, 1.0), ("continuous", 0.995, 1.0)]
)
def test_efficiency_of_the_papers_instrument(mode: str, least: float, most: float) -> None:
    async def main() -> scanhsi.ScanReport:
        async with scanhsi.open_instrument("sensors2019", seed=1) as hsi:
            plan = hsi.default_plan(lines=1200, exposure="100 ms", pixel_format="Mono8", mode=mode)
            return await hsi.scan(plan, None)

    report = run_virtual(main())
    assert least <= report.efficiency <= most
    assert report.regret is not None
    assert 1 <= report.regret <= 1.0005
    assert report.missing == 0


def test_refusals_touch_nothing(tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()

    async def main() -> None:
        async with scanhsi.open_instrument(small()) as hsi:
            with pytest.raises(CubeExists):
                await hsi.scan(hsi.default_plan(lines=2), tmp_path / "there")
            with pytest.raises(OutOfRange, match="exposure 3 s is not allowed; allowed is 0.01 to 2 s"):
                await hsi.scan(hsi.default_plan(lines=2, exposure="3 s"), tmp_path / "new.zarr")
            with pytest.raises(OutOfRange, match="allowed is -2400 to 2400 steps"):
                await hsi.scan(hsi.default_plan(lines=2, start=5000), tmp_path / "new.zarr")
            with pytest.raises(scanhsi.ConfigError, match="no such key"):
                hsi.default_plan(line=2)

    run_virtual(main())
    assert list(tmp_path.iterdir()) == [tmp_path / "there"]
    assert not list((tmp_path / "there").iterdir())


def test_one_scan_at_a_time() -> None:
    async def main() -> None:
        async with scanhsi.open_instrument(small()) as hsi:
            first = asyncio.ensure_future(hsi.scan(hsi.default_plan(lines=5), None))
            await asyncio.sleep(0.05)
            with pytest.raises(DeviceBusy, match="a scan is under way"):
                await hsi.scan(hsi.default_plan(lines=5), None)
            assert (await first).missing == 0
            assert (await hsi.scan(hsi.default_plan(lines=5), None)).missing == 0

    run_virtual(main())


def test_limits_of_the_instrument_hold_for_the_run_up_of_a_sweep_too(tmp_path: Path) -> None:
    async def main() -> None:
        config = load_instrument("sensors2019", {**SMALL, "limits.steps": [-20, 20]})
        async with scanhsi.open_instrument(config) as hsi:
            assert (await hsi.scan(hsi.default_plan(lines=20), None)).missing == 0
            with pytest.raises(
                OutOfRange, match="run-up or run-out -?[0-9]+ steps is not allowed; allowed is -20 to 20"
            ):
                await hsi.scan(hsi.default_plan(lines=20, mode="continuous"), tmp_path / "new.zarr")

    run_virtual(main())
    assert not list(tmp_path.iterdir())
