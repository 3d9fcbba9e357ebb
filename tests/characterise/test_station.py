"""Who is asked to put targets before the instrument, and what a cancelled protocol leaves."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

import scanhsi
from scanhsi.characterise.station import Target, station
from scanhsi.clock import run_virtual
from scanhsi.devices import ShowsScenes
from scanhsi.devices.errors import CalibrationError
from scanhsi.instrument import load_instrument

SMALL = {"roi.samples": 16, "roi.bands": 8, "roi.sample_offset": 1000, "roi.band_offset": 500, "camera.scene": "white"}
MOON = Target("moon", "Open the roof.")


def test_a_person_is_asked_for_what_cannot_be_simulated() -> None:
    asked: list[str] = []

    async def person(target: Target) -> None:
        asked.append(target.request)

    async def main() -> None:
        async with scanhsi.open_instrument(load_instrument("sensors2019", SMALL)) as hsi:
            async with station(hsi, None, prompt=person) as at:
                await at.look_at(MOON)
            async with station(hsi, None) as at:
                with pytest.raises(CalibrationError, match="somebody has to act: Open the roof"):
                    await at.look_at(MOON)

    run_virtual(main())
    assert asked == ["Open the roof."]


def test_a_cancelled_protocol_leaves_valid_cubes_no_result_and_its_own_scene(tmp_path: Path) -> None:
    async def main() -> str:
        async with scanhsi.open_instrument(load_instrument("sensors2019", SMALL)) as hsi:
            work = asyncio.create_task(hsi.calibrate.dark(tmp_path / "dark.nc", exposures_s=[0.05, 1.0], frames=10))
            await asyncio.sleep(8.0)
            work.cancel()
            with pytest.raises(asyncio.CancelledError):
                await work
            assert (await hsi.scan(hsi.default_plan(lines=3), None)).missing == 0
            assert isinstance(hsi.camera, ShowsScenes)
            return hsi.camera.scene

    assert run_virtual(main()) == "white"
    assert not (tmp_path / "dark.nc").exists()
    cubes = [scanhsi.open_cube(cube) for cube in sorted((tmp_path / "dark-cubes").iterdir())]
    assert cubes[0].attrs["lines_stored"] == 10
    assert 0 < cubes[1].attrs["lines_stored"] < 10
