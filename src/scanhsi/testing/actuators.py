"""The actuator contract as tests; see `scanhsi.devices.actuator`."""

from __future__ import annotations

import asyncio
from contextlib import suppress

import pytest

from scanhsi.clock import now_ns
from scanhsi.devices import Actuator
from scanhsi.devices.errors import DeviceBusy, DeviceError, OutOfRange
from scanhsi.testing.actuator_abilities import ActuatorAbilities
from scanhsi.testing.actuator_cancelled import ActuatorCancelled
from scanhsi.testing.actuator_suite import ActuatorSuite
from scanhsi.testing.devices import refused


class ActuatorConformance(ActuatorAbilities, ActuatorCancelled, ActuatorSuite):
    """Inherit, write ``make``, and every test below runs on your actuator; its attributes are those of `ActuatorSuite`."""

    # --- being there ------------------------------------------------------------------------------------------------------

    def test_info(self) -> None:
        """After ``connect`` the info is whole."""

        async def use(actuator: Actuator) -> None:
            info = actuator.info
            assert info.name
            assert info.steps_per_revolution > 0
            assert info.limits.minimum < info.limits.maximum
            assert info.max_rate_steps_s > 0
            assert info.settle_s >= 0

        self.run(use)

    def test_connect_moves_nothing(self) -> None:
        """Connecting twice in a row finds the mirror where it was."""

        async def use(actuator: Actuator) -> int | None:
            try:
                return actuator.position
            except DeviceError:  # not homed: nobody knows
                return None

        assert self.run(use) == self.run(use)

    def test_close_is_idempotent_and_may_come_at_any_time(self) -> None:
        """``close`` and ``stop`` in any state."""

        async def use(actuator: Actuator) -> None:
            await actuator.close()
            await actuator.connect()
            await actuator.stop()
            await actuator.stop()
            await actuator.close()
            await actuator.close()

        self.run(use, connected=False)

    def test_a_second_user_is_refused(self) -> None:
        """`DeviceBusy` for whoever comes second; the first is not disturbed."""
        if not self.exclusive:
            pytest.skip("the device may be shared (exclusive = False)")

        async def use(actuator: Actuator) -> None:
            await self.ready(actuator)
            second = self.make()
            try:
                await refused("connecting a second object", (DeviceBusy,), second.connect())
            finally:
                await second.close()
            await actuator.move_to(self.travel)
            assert actuator.position == self.travel

        self.run(use)

    # --- moving -----------------------------------------------------------------------------------------------------------

    def test_home_is_step_0(self) -> None:
        """Homing ends at step 0 and makes steps mean angles."""

        async def use(actuator: Actuator) -> None:
            motion = await actuator.home()
            assert motion.step == actuator.position == 0
            assert actuator.homed

        self.run(use)

    def test_it_goes_where_it_is_told(self) -> None:
        """Up, down, on the spot: step, position and stamps agree; it returns after motion and settle."""

        async def use(actuator: Actuator) -> None:
            await self.ready(actuator)
            for step in (self.travel, self.travel, -self.travel, 0, 1):
                before = now_ns()
                motion = await actuator.move_to(step)
                after = now_ns()
                assert motion.step == actuator.position == step
                assert before <= motion.commanded_ns <= motion.moved_ns <= after + 1
                if motion.started_ns is not None:
                    assert motion.commanded_ns <= motion.started_ns <= motion.moved_ns

        self.run(use)

    def test_limits_hold_before_anything_moves(self) -> None:
        """`OutOfRange` beyond either limit, and the position has not changed."""

        async def use(actuator: Actuator) -> None:
            await self.ready(actuator)
            await actuator.move_to(3)
            limits = actuator.info.limits
            for step in (int(limits.maximum) + 1, int(limits.minimum) - 1, int(limits.maximum) * 100):
                await refused(f"move_to({step})", (OutOfRange,), actuator.move_to(step))
                assert actuator.position == 3

        self.run(use)

    # --- stopping ---------------------------------------------------------------------------------------------------------

    @pytest.mark.parametrize("share", [0.0, 0.3, 0.8])
    def test_stop_ends_a_motion(self, share: float) -> None:
        """``stop`` beside a running ``move_to``: both return soon, the mirror stands, and can be moved again."""

        async def use(actuator: Actuator) -> None:
            await self.ready(actuator)
            far = self.far(actuator)
            whole = await self.duration_s(actuator, far)
            moving = asyncio.ensure_future(actuator.move_to(far))
            await asyncio.sleep(share * whole)
            await actuator.stop()
            with suppress(DeviceError):
                await moving
            await self.works(actuator)

        self.run(use)

    @pytest.mark.parametrize("share", [0.0, 0.3, 0.8, 1.01])
    def test_a_cancelled_motion_and_a_stop(self, share: float) -> None:
        """Cancelled at some moment: the caller stops it, and it works again."""

        async def use(actuator: Actuator) -> None:
            await self.ready(actuator)
            far = self.far(actuator)
            whole = await self.duration_s(actuator, far)
            moving = asyncio.ensure_future(actuator.move_to(far))
            await asyncio.sleep(share * whole)
            moving.cancel()
            with suppress(asyncio.CancelledError, DeviceError):
                await moving
            await actuator.stop()
            await self.works(actuator)

        self.run(use)

    def test_stop_of_what_stands(self) -> None:
        """Again and again, beside nothing, and the position stays."""

        async def use(actuator: Actuator) -> None:
            await self.ready(actuator)
            await actuator.move_to(5)
            for _ in range(3):
                await actuator.stop()
            await self.works(actuator)

        self.run(use)

    def test_out_of_order_calls_are_errors_of_the_tree(self) -> None:
        """Moving what is not connected: a `DeviceError`, and no hang."""

        async def use(actuator: Actuator) -> None:
            await refused("move_to() before connect()", (DeviceError,), actuator.move_to(1))
            await actuator.connect()
            await self.works(actuator)

        self.run(use, connected=False)
