"""Actuators that are cancelled, closed and opened anew; see `scanhsi.devices.actuator`."""

from __future__ import annotations

import asyncio
from contextlib import suppress

import pytest

from scanhsi.devices import Actuator
from scanhsi.devices.errors import DeviceError
from scanhsi.testing.actuator_suite import ActuatorSuite
from scanhsi.testing.devices import cancelled_after


class ActuatorCancelled(ActuatorSuite):
    """Whatever is cancelled, and whenever, what comes after it works."""

    @pytest.mark.parametrize("rounds", [0, 1, 3])
    @pytest.mark.parametrize("method", ["connect", "home", "stop", "close"])
    def test_any_method_may_be_cancelled(self, method: str, rounds: int) -> None:
        """Cancelled after some rounds of the loop: ``stop`` and ``close`` work, then it can be opened, homed and moved."""

        async def use(actuator: Actuator) -> None:
            if method != "connect":
                await actuator.connect()
            call = {
                "connect": actuator.connect,
                "home": actuator.home,
                "stop": actuator.stop,
                "close": actuator.close,
            }[method]
            await cancelled_after(rounds, call())
            with suppress(DeviceError):  # where connecting was cancelled, there may be nothing to stop
                await actuator.stop()
            await actuator.close()
            await actuator.connect()
            await self.works(actuator)

        self.run(use, connected=False)

    def test_stop_ends_homing(self) -> None:
        """``stop`` beside a running ``home``: both return, and it can be homed."""

        async def use(actuator: Actuator) -> None:
            homing = asyncio.ensure_future(actuator.home())
            await asyncio.sleep(0.01)
            await actuator.stop()
            with suppress(DeviceError):
                await homing
            await actuator.home()
            await self.works(actuator)

        self.run(use)

    def test_a_stopped_motion_says_where_it_is(self) -> None:
        """``position`` is between start and target, and steps mean what they meant."""

        async def use(actuator: Actuator) -> None:
            await self.ready(actuator)
            far = self.far(actuator)
            whole = await self.duration_s(actuator, far)
            moving = asyncio.ensure_future(actuator.move_to(far))
            await asyncio.sleep(0.4 * whole)
            await actuator.stop()
            with suppress(DeviceError):
                await moving
            if actuator.homed:
                play = actuator.info.backlash_steps
                assert -play <= actuator.position <= far + play
            await self.works(actuator)

        self.run(use)

    def test_the_same_object_can_be_opened_anew(self) -> None:
        """``close`` and ``connect``: ``homed`` tells whether steps still mean the same; where it is true, they do."""

        async def use(actuator: Actuator) -> None:
            await self.ready(actuator)
            await actuator.move_to(self.travel)
            await actuator.close()
            with suppress(DeviceError):  # it may be known without a device
                assert actuator.info.name
            await actuator.connect()
            if actuator.homed:
                assert actuator.position == self.travel
            await self.works(actuator)

        self.run(use)

    def test_the_loop_goes_on_beside_a_motion(self) -> None:
        """What blocks runs in a thread: other tasks run while the mirror moves."""

        async def use(actuator: Actuator) -> None:
            await self.ready(actuator)
            far = self.far(actuator)
            whole = await self.duration_s(actuator, far)
            rounds = 0

            async def count() -> None:
                nonlocal rounds
                while True:
                    await asyncio.sleep(whole / 20)
                    rounds += 1

            counting = asyncio.ensure_future(count())
            await asyncio.sleep(0)
            for step in (far, 0, far):
                await actuator.move_to(step)
            counting.cancel()
            assert rounds > 3, "the event loop stood still while the mirror moved"

        self.run(use)
