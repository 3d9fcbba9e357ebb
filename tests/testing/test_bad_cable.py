"""A bad serial cable between the stepper's driver and its firmware in the emulator."""

from __future__ import annotations

import pytest

from scanhsi.clock import run
from scanhsi.testing.faults import Fault, FaultPlan, Kind
from scanhsi.testing.faulty_bytes import faulty_port
from scanhsi_sim.twins.stepper import StepperTwin, StepperTwinSettings
from scanhsi_sim.twins.stepper_build import missing_tools
from scanhsi_stepper import StepperActuator, StepperOptions

pytestmark = [pytest.mark.twin, pytest.mark.skipif(bool(missing_tools()), reason=str(missing_tools()))]

PLAN = FaultPlan(
    faults=(
        Fault(kind=Kind.BYTE_GARBLED, nth=60, lasts=3),
        Fault(kind=Kind.BYTE_DROPPED, nth=200),
        Fault(kind=Kind.BYTE_TWICE, nth=320, lasts=2),
    ),
    seed=5,
)


@pytest.mark.parametrize("rate", [0.0, 0.005])
def test_no_move_is_lost_or_made_twice(rate: float) -> None:
    async def main() -> None:
        async with StepperTwin(StepperTwinSettings(speed=20.0)) as twin:
            with faulty_port(twin.port, PLAN, rate=rate) as port:
                options = StepperOptions(
                    port=port, settle_s=0.0, motion_margin_s=10.0, reply_timeout_s=0.05, reply_attempts=40
                )
                actuator = StepperActuator(options)
                await actuator.connect()
                try:
                    await actuator.home()
                    at_home = (await twin.stats())["position"]
                    for step in (5, 12, 3, -4, 20, 21, 7):
                        motion = await actuator.move_to(step)
                        assert motion.step == step
                    assert (await twin.stats())["position"] == at_home + 7
                    counters = actuator.counters
                    assert counters.bad_lines + counters.naks + counters.resends + counters.done_by_poll > 0
                finally:
                    await actuator.close()

    run(main())
