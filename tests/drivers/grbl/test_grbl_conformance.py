"""The suite for drivers, on the GRBL driver: against our own motion core that speaks GRBL, and against GRBL itself where named.

``SCANHSI_GRBL_ELF=path pytest -m twin tests/drivers/grbl`` takes an ATmega328P image of GRBL 1.1. It is built from its own
sources (GPL-3.0) and is no part of this project.
"""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
import serial

from scanhsi.testing.conformance import ActuatorConformance
from scanhsi_grbl import GrblActuator, GrblOptions
from scanhsi_sim.twins.stepper import StepperTwinSettings
from scanhsi_sim.twins.stepper_build import firmware_elf
from support.bench_thread import bench_in_thread

GRBL = os.environ.get("SCANHSI_GRBL_ELF")


@pytest.mark.twin
class TestGrblDialect(ActuatorConformance):
    travel = 12

    @pytest.fixture(autouse=True)
    def _on_the_bench(self) -> Iterator[None]:
        with bench_in_thread(StepperTwinSettings(speed=5, start_step=30, firmware=firmware_elf("grbl"))) as twin:
            self.port = twin.port
            yield

    def make(self) -> GrblActuator:
        return GrblActuator(GrblOptions(port=self.port, settle_s=0.0, motion_margin_s=10.0))


@pytest.mark.twin
class GrblItself(ActuatorConformance):
    """Homing is off: GRBL as it is distributed homes all three axes, and the bench has one."""

    @pytest.fixture(autouse=True)
    def _on_the_bench(self) -> Iterator[None]:
        assert GRBL is not None
        with bench_in_thread(StepperTwinSettings(firmware=Path(GRBL), grbl_shield=True)) as twin:
            set_up(twin.port)
            self.port = twin.port
            yield

    def make(self) -> GrblActuator:
        return GrblActuator(GrblOptions(port=self.port, settle_s=0.0, motion_margin_s=10.0))


if GRBL is None:

    def test_grbl_itself() -> None:
        pytest.skip("SCANHSI_GRBL_ELF names no image of GRBL 1.1")
else:
    TestGrblItself = GrblItself


def set_up(port: str) -> None:
    """As the how-to says: a unit of 1000 steps, motor always powered; no switch."""
    with serial.Serial(port, 115_200, timeout=5) as line:
        assert line.read_until(b"help]\r\n")
        line.timeout = 0.5
        line.read_until(b"no more start-up lines")
        line.timeout = 5
        for setting in ("$1=255", "$3=1", "$20=0", "$22=0", "$100=1000", "$110=240", "$120=20"):
            line.write(f"{setting}\n".encode())
            assert line.readline() == b"ok\r\n"
