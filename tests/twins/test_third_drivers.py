"""A whole instrument of the other drivers: GRBL in the emulator, the fake camera of another GenICam stack, a light on a relay."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import pytest

import scanhsi
from scanhsi import clock
from scanhsi.instrument import load_instrument
from scanhsi_sim.twins.stepper import StepperTwin, StepperTwinSettings
from scanhsi_sim.twins.stepper_build import firmware_elf
from support.genicam_fake import FakeCamera
from support.relay_module import RelayModule

pytestmark = pytest.mark.twin

INSTRUMENT = """
[camera]
driver = "genicam"
address = "127.0.0.1"
interface = "lo"

[actuator]
driver = "grbl"
port = "{mirror}"
settle_s = 0.0
simulated = true

[light]
driver = "numato"
port = "{light}"
relay = 2
warm_up_s = 0.2
simulated = true

[geometry]
distance = "350 mm"
normal_step = 0

[roi]
samples = 64
bands = 32

[scan]
mode = "stepped"
lines = 12
step = -3
exposure = "2 ms"
pixel_format = "Mono8"
"""


def test_a_scan_with_the_other_drivers(tmp_path: Path) -> None:
    camera, relays = FakeCamera(), RelayModule()

    async def main() -> scanhsi.ScanReport:
        settings = StepperTwinSettings(start_step=30, firmware=firmware_elf("grbl"))
        async with StepperTwin(settings) as mirror:
            file = tmp_path / "others.toml"
            file.write_text(INSTRUMENT.format(mirror=mirror.port, light=relays.port))
            async with scanhsi.open_instrument(load_instrument(file)) as hsi:
                report = await hsi.scan(hsi.default_plan(), tmp_path / "cube.zarr")
                last = hsi.actuator.position
            assert (await mirror.stats())["position"] == last + 1000  # homing pulls off by so much
            return report

    try:
        report = clock.run(main())
    finally:
        camera.close()
        relays.close()
    assert (report.stored, report.missing) == (12, 0)
    cube = scanhsi.open_cube(tmp_path / "cube.zarr")
    steps = cube["mirror_step"].values.tolist()
    assert [after - before for before, after in pairwise(steps)] == [-3] * 11
    assert cube["cube"].values.any()
    assert cube.attrs["simulated"] is True
    switched = [command for command in relays.commands if "read" not in command]
    assert switched[0] == "ver"
    assert "relay on 2" in switched
    assert switched[-1] == "relay off 2"
    assert not any(relays.relays)
