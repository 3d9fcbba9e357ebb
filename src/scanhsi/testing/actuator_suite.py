"""What the tests of the actuator contract are made of."""

from __future__ import annotations

from typing import ClassVar

from scanhsi.devices import Actuator, Motion
from scanhsi.testing.devices import DeviceConformance


class ActuatorSuite(DeviceConformance[Actuator]):
    """What the tests of actuators are made of.

    Attributes:
        travel: Steps that the tests move by; must fit between the limits on both sides of the home position.
    """

    travel: ClassVar[int] = 40

    async def ready(self, actuator: Actuator) -> None:
        """Home it, if it does not know where it is."""
        if not actuator.homed:
            await actuator.home()

    def far(self, actuator: Actuator) -> int:
        """A step that takes a while to be reached."""
        return min(int(actuator.info.limits.maximum), 10 * self.travel)

    async def duration_s(self, actuator: Actuator, step: int) -> float:
        """How long a motion takes, there; and back at the start."""
        await actuator.move_to(0)
        motion: Motion = await actuator.move_to(step)
        await actuator.move_to(0)
        return (motion.moved_ns - motion.commanded_ns) * 1e-9

    async def works(self, actuator: Actuator) -> None:
        """It can be moved."""
        await self.ready(actuator)
        motion = await actuator.move_to(7)
        assert motion.step == actuator.position == 7
