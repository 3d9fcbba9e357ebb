"""The suite for drivers, on the real actuator driver against the real firmware in the emulator."""

import asyncio
import threading
from collections.abc import Iterator

import pytest

from scanhsi.testing.conformance import ActuatorConformance
from scanhsi_sim.twins.stepper import StepperTwin, StepperTwinSettings
from scanhsi_stepper import StepperActuator, StepperOptions


@pytest.mark.twin
class TestStepper(ActuatorConformance):
    @pytest.fixture(autouse=True)
    def _on_the_twin(self) -> Iterator[None]:
        """The twin lives in a loop of its own: the suite runs one for each use of the device."""
        loop = asyncio.new_event_loop()
        thread = threading.Thread(target=loop.run_forever)
        thread.start()
        twin = StepperTwin(StepperTwinSettings(start_step=30))  # in real time: the suite looks at stamps

        async def enter() -> None:
            await twin.__aenter__()

        async def leave() -> None:
            await twin.__aexit__(None, None, None)

        try:
            asyncio.run_coroutine_threadsafe(enter(), loop).result(60)
            self.port = twin.port
            yield
            asyncio.run_coroutine_threadsafe(leave(), loop).result(30)
        finally:
            loop.call_soon_threadsafe(loop.stop)
            thread.join()
            loop.close()

    def make(self) -> StepperActuator:
        return StepperActuator(StepperOptions(port=self.port, settle_s=0.0, motion_margin_s=10.0))
