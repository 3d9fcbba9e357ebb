"""Many twin scans on a computer that is busy with something else: ``make soak``. Not part of ``make test``."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import scanhsi
from scanhsi import clock
from scanhsi.instrument import load_instrument
from scanhsi_sim.twins.rig import TwinRig
from support.exact import wrong_lines

pytestmark = [pytest.mark.twin, pytest.mark.soak, pytest.mark.timeout(300)]


@pytest.fixture
def hog() -> Iterator[None]:
    """A process that wants a whole processor."""
    with subprocess.Popen([sys.executable, "-c", "while True: pass"]) as process:
        yield
        process.kill()


@pytest.mark.usefixtures("hog")
@pytest.mark.parametrize("run", range(10))
@pytest.mark.parametrize(
    "plan", [{"mode": "stepped"}, {"mode": "continuous", "period": "60 ms"}], ids=lambda plan: plan["mode"]
)
def test_every_line_is_exact_however_busy_the_computer(plan: dict[str, str], run: int, tmp_path: Path) -> None:
    """In a sweep a busy computer may cost lines, which are then marked missing; never a wrong pixel."""

    async def main() -> scanhsi.ScanReport:
        async with TwinRig(seed=run) as rig:
            config = load_instrument("twin", {"actuator.port": rig.port, "camera.address": rig.camera_address})
            async with scanhsi.open_instrument(config) as hsi:
                asked = hsi.default_plan(lines=300, step=2, exposure="10 ms", pixel_format="Mono12Packed", **plan)
                return await hsi.scan(asked, tmp_path / "cube.zarr")

    report = clock.run(main())
    assert report.stored + report.missing == 300
    assert report.missing == 0 or plan["mode"] == "continuous", report.missing_reasons
    assert wrong_lines(tmp_path / "cube.zarr") == []
