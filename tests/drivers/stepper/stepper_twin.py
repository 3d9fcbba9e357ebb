"""Helpers of the tests that run the real firmware in the emulator."""

from __future__ import annotations

from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Any

from scanhsi.clock import run
from scanhsi_sim.twins.stepper import StepperTwin, StepperTwinSettings
from scanhsi_stepper import StepperActuator, StepperOptions

FAST = 20.0  # times real time; assertions are on simulated cycles or on order, never on wall time


@asynccontextmanager
async def twin_and_actuator(
    settings: StepperTwinSettings | None = None, **options: Any
) -> AsyncIterator[tuple[StepperTwin, StepperActuator]]:
    """A running bench and a connected actuator."""
    async with StepperTwin(settings or StepperTwinSettings(speed=FAST)) as twin:
        actuator = StepperActuator(
            StepperOptions(port=twin.port, **{"settle_s": 0.0, "motion_margin_s": 10.0, **options})
        )
        await actuator.connect()
        try:
            yield twin, actuator
        finally:
            await actuator.close()


def bench(
    scenario: Callable[[StepperTwin, StepperActuator], Awaitable[None]],
    settings: StepperTwinSettings | None = None,
    **options: Any,
) -> None:
    """Run a scenario against the firmware in the emulator."""

    async def main() -> None:
        async with twin_and_actuator(settings, **options) as (twin, actuator):
            await scenario(twin, actuator)

    run(main())


async def request(actuator: StepperActuator, command: str) -> tuple[str, ...]:
    """A bare request of the protocol, past the actuator's own logic."""
    link = actuator._link
    assert link is not None
    return await link.request(command)
