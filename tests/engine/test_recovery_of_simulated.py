"""A line that is taken again is the line that would have been taken: on the simulated instrument, with a drive that has play."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import scanhsi
from scanhsi.clock import run_virtual
from scanhsi.devices import Exposure
from scanhsi.devices.errors import DeviceLost
from scanhsi.engine import control
from scanhsi.instrument import load_instrument
from scanhsi_sim.camera import SimulatedCamera
from support.small import SMALL as PART

SMALL = {**PART, "actuator.mirror": {"backlash_steps": 7}}


def scan(path: Path, **plan: Any) -> scanhsi.ScanReport:
    async def main() -> scanhsi.ScanReport:
        async with scanhsi.open_instrument(load_instrument("sensors2019", SMALL)) as hsi:
            return await hsi.scan(hsi.default_plan(lines=24, on_fault="retry", **plan), path)

    return run_virtual(main())


@pytest.fixture
def unplug(monkeypatch: pytest.MonkeyPatch) -> None:
    """The camera is lost in two exposures."""
    count = [0]
    expose = SimulatedCamera.expose

    async def sometimes(self: SimulatedCamera) -> Exposure:
        count[0] += 1
        if count[0] in (9, 16):
            raise DeviceLost("unplugged.", device=self.info.name)
        return await expose(self)

    monkeypatch.setattr(SimulatedCamera, "expose", sometimes)


def differing(folder: Path) -> list[int]:
    pixels = [scanhsi.open_cube(folder / name)["cube"].values for name in ("whole.zarr", "mended.zarr")]
    return [line for line in range(24) if np.any(pixels[0][:, line] != pixels[1][:, line])]


@pytest.mark.parametrize("step", [2, -2])
@pytest.mark.parametrize("mode", ["sequential", "stepped"])
def test_the_play_of_the_drive_does_not_show(mode: str, step: int, tmp_path: Path, request: Any) -> None:
    scan(tmp_path / "whole.zarr", mode=mode, step=step)
    request.getfixturevalue("unplug")
    report = scan(tmp_path / "mended.zarr", mode=mode, step=step)
    assert (report.stored, len(report.incidents)) == (24, 2)
    assert differing(tmp_path) == []


def test_a_line_that_is_approached_from_the_other_side_would_be_seen(
    tmp_path: Path, request: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    scan(tmp_path / "whole.zarr")
    request.getfixturevalue("unplug")
    monkeypatch.setattr(control, "_way_off", lambda scan, step: step + 64)
    scan(tmp_path / "mended.zarr")
    assert differing(tmp_path)
