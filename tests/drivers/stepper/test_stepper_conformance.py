"""The suite for drivers, on the real actuator driver against the real firmware in the emulator."""

from collections.abc import Iterator

import pytest

from scanhsi.testing.conformance import ActuatorConformance
from scanhsi_sim.twins.stepper import StepperTwinSettings
from scanhsi_stepper import StepperActuator, StepperOptions
from support.bench_thread import bench_in_thread


@pytest.mark.twin
class TestStepper(ActuatorConformance):
    @pytest.fixture(autouse=True)
    def _on_the_twin(self) -> Iterator[None]:
        with bench_in_thread(StepperTwinSettings(start_step=30)) as twin:  # in real time: the suite looks at stamps
            self.port = twin.port
            yield

    def make(self) -> StepperActuator:
        return StepperActuator(StepperOptions(port=self.port, settle_s=0.0, motion_margin_s=10.0))
