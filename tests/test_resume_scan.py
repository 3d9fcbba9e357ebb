"""An interrupted scan is finished by another session: only what is not stored is taken, and only with the same instrument."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import scanhsi
from scanhsi.clock import run_virtual
from scanhsi.cube.reader import read_records
from scanhsi.devices import ShowsScenes
from scanhsi.devices.errors import ConfigError, CubeError, NotACube
from scanhsi.engine import OnFault, ScanControl
from scanhsi.instrument import InstrumentConfig, load_instrument
from scanhsi_sim.scenes.testpattern import decode
from support.small import SMALL as PART

LINES = 40
SMALL = {**PART, "storage.lines_per_shard": 8}


def small(**changes: Any) -> InstrumentConfig:
    return load_instrument("sensors2019", {**SMALL, **changes})


async def begin(path: Path, after_s: float, mode: str = "stepped") -> scanhsi.ScanReport:
    async with scanhsi.open_instrument(small()) as hsi:
        control = ScanControl()
        asyncio.get_running_loop().call_later(after_s, control.stop.set)
        return await hsi.scan(hsi.default_plan(lines=LINES, mode=mode), path, control=control)


async def go_on(path: Path, config: InstrumentConfig | None = None, **kwargs: Any) -> scanhsi.ScanReport:
    async with scanhsi.open_instrument(config or small()) as hsi:
        return await hsi.resume(path, **kwargs)


def check_whole(path: Path) -> None:
    cube = scanhsi.open_cube(path)
    assert (cube["status"].values == 1).all()
    for line in range(LINES):
        seen = decode(cube["cube"].isel(line=line).values, offset=(500, 1000))
        assert seen.step == int(cube["mirror_step"][line]) % 4096, line
    assert np.all(np.diff(cube["mirror_step"].values) == 2)


@pytest.mark.parametrize("mode", ["sequential", "stepped", "continuous"])
def test_only_what_is_not_stored_is_taken(mode: str, tmp_path: Path) -> None:
    path = tmp_path / "cube.zarr"
    first = run_virtual(begin(path, 3.0, mode))
    assert 0 < first.stored < LINES
    before = read_records(path)
    report = run_virtual(go_on(path))
    assert (report.stored, report.missing, report.resumed_at) == (LINES, 0, first.stored)
    check_whole(path)
    after = read_records(path)
    np.testing.assert_array_equal(before.frame_id, after.frame_id[: before.lines])
    assert after.run.tolist() == [0] * first.stored + [1] * (LINES - first.stored)
    assert report.duration_s < 5


def test_stopped_again_and_again(tmp_path: Path) -> None:
    path = tmp_path / "cube.zarr"
    run_virtual(begin(path, 2.4))
    for _ in range(2):
        control = ScanControl()

        async def main(control: ScanControl = control) -> scanhsi.ScanReport:
            asyncio.get_running_loop().call_later(2.4, control.stop.set)
            return await go_on(path, control=control)

        assert run_virtual(main()).stopped_early
    run_virtual(go_on(path))
    check_whole(path)
    assert set(read_records(path).run.tolist()) == {0, 1, 2, 3}


def test_another_policy_is_the_same_plan(tmp_path: Path) -> None:
    path = tmp_path / "cube.zarr"
    run_virtual(begin(path, 3.0))

    async def main() -> scanhsi.ScanReport:
        async with scanhsi.open_instrument(small()) as hsi:
            return await hsi.resume(path, hsi.default_plan(lines=LINES, on_fault=OnFault.RETRY))

    assert run_virtual(main()).stored == LINES


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"camera.scene": "white"}, "instrument.camera.scene: 'testpattern' when the cube was begun, 'white' now"),
        ({"camera.seed": 9}, "device camera.serial"),
        ({"geometry.normal_step": 3}, "instrument.geometry.normal_step: 0 when the cube was begun, 3 now"),
        ({"roi.samples": 20}, "instrument.roi.samples: 24 when the cube was begun, 20 now"),
        ({"spectral.wavelength_nm": [400.0, 1.0]}, "instrument.spectral.wavelength_nm"),
    ],
)
def test_another_instrument_is_refused_with_each_difference(
    changes: dict[str, Any], words: str, tmp_path: Path
) -> None:
    path = tmp_path / "cube.zarr"
    run_virtual(begin(path, 3.0))
    before = {file: file.read_bytes() for file in path.rglob("*") if file.is_file()}
    with pytest.raises(ConfigError) as refused:
        run_virtual(go_on(path, small(**changes)))
    assert words in str(refused.value)
    assert {file: file.read_bytes() for file in path.rglob("*") if file.is_file()} == before
    run_virtual(go_on(path))  # and nothing is locked


def test_another_scene_before_the_camera_is_told_and_refused(tmp_path: Path) -> None:
    path = tmp_path / "cube.zarr"
    run_virtual(begin(path, 3.0))
    assert scanhsi.open_cube(path).attrs["devices"]["camera"]["scene"] == "testpattern"

    async def main() -> None:
        async with scanhsi.open_instrument(small()) as hsi:
            assert isinstance(hsi.camera, ShowsScenes)
            await hsi.camera.show("white")
            await hsi.resume(path)

    with pytest.raises(ConfigError, match="device camera.scene: 'testpattern' when the cube was begun, 'white' now"):
        run_virtual(main())


def test_another_plan_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "cube.zarr"
    run_virtual(begin(path, 3.0))

    async def main() -> None:
        async with scanhsi.open_instrument(small()) as hsi:
            await hsi.resume(path, hsi.default_plan(lines=LINES + 1, exposure="30 ms"))

    with pytest.raises(ConfigError) as refused:
        run_virtual(main())
    assert len(refused.value.problems) == 2


def test_nothing_to_resume(tmp_path: Path) -> None:
    path = tmp_path / "cube.zarr"
    with pytest.raises(NotACube):
        run_virtual(go_on(path))
    run_virtual(begin(path, 1e6))
    with pytest.raises(CubeError, match="is complete"):
        run_virtual(go_on(path))


def test_a_plan_that_the_devices_refuse_leaves_the_cube_unlocked(tmp_path: Path) -> None:
    path = tmp_path / "cube.zarr"
    run_virtual(begin(path, 3.0))
    with pytest.raises(scanhsi.ScanhsiError, match="is not allowed"):
        run_virtual(go_on(path, small(**{"limits.steps": [-5, 5]})))
    assert run_virtual(go_on(path)).stored == LINES
