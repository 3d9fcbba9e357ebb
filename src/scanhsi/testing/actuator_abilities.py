"""The optional abilities of actuators as tests; see `scanhsi.devices.capabilities`. What an actuator lacks is skipped."""

from __future__ import annotations

import asyncio
from contextlib import suppress

import pytest

from scanhsi.clock import now_ns
from scanhsi.devices import Actuator, Sweep, Sweeps, TellsStart
from scanhsi.devices.errors import DeviceError, OutOfRange, UnsupportedFeature
from scanhsi.testing.actuator_suite import ActuatorSuite


class ActuatorAbilities(ActuatorSuite):
    """Sweeps, and when motions begin."""

    def test_sweeps(self) -> None:
        """`Sweeps`: never faster than asked, within the extent told, ends standing, counts its pulses."""

        async def use(actuator: Actuator) -> None:
            if not isinstance(actuator, Sweeps):
                pytest.skip("it does not sweep")
            await self.ready(actuator)
            rate = min(200.0, actuator.info.max_rate_steps_s / 4)
            asked = Sweep(first=-10, every=2, count=11, rate_steps_s=rate)
            sweep = actuator.check_sweep(asked)
            assert sweep.rate_steps_s <= asked.rate_steps_s * 1.000001
            assert (sweep.first, sweep.every, sweep.count) == (asked.first, asked.every, asked.count)
            low, high = actuator.extent(sweep)
            assert low <= sweep.first
            assert high >= sweep.last
            assert actuator.run_up_s(sweep) >= 0
            await actuator.prepare_sweep(sweep)
            motion = await actuator.sweep(sweep)
            assert motion.moved_ns - motion.commanded_ns >= (sweep.count - 1) * sweep.period_s * 0.9e9
            assert low <= actuator.position <= high
            if _gives_pulses(actuator, asked):
                pulsed = actuator.check_sweep(_with_pulses(asked))
                await actuator.prepare_sweep(pulsed)
                assert (await actuator.sweep(pulsed)).pulses == asked.count

        self.run(use)

    def test_a_sweep_beyond_the_limits_is_refused(self) -> None:
        """`OutOfRange` before anything moves: limits, run-up included, and speed."""

        async def use(actuator: Actuator) -> None:
            if not isinstance(actuator, Sweeps):
                pytest.skip("it does not sweep")
            await self.ready(actuator)
            info = actuator.info
            outside = int(info.limits.maximum)
            for sweep in (
                Sweep(first=outside - 5, every=1, count=20, rate_steps_s=100),
                Sweep(first=0, every=1, count=10, rate_steps_s=info.max_rate_steps_s * 10),
            ):
                with pytest.raises(OutOfRange):
                    actuator.check_sweep(sweep)

        self.run(use)

    def test_a_sweep_can_be_stopped(self) -> None:
        """``stop`` beside a running sweep."""

        async def use(actuator: Actuator) -> None:
            if not isinstance(actuator, Sweeps):
                pytest.skip("it does not sweep")
            await self.ready(actuator)
            sweep = actuator.check_sweep(Sweep(first=0, every=1, count=100, rate_steps_s=100))
            await actuator.prepare_sweep(sweep)
            sweeping = asyncio.ensure_future(actuator.sweep(sweep))
            await asyncio.sleep(actuator.run_up_s(sweep) + 0.3)
            await actuator.stop()
            with suppress(DeviceError):
                await sweeping
            await self.works(actuator)

        self.run(use)

    def test_sweeps_downwards_and_tells_where_it_is(self) -> None:
        """A negative ``every``; ``prepare_sweep`` ends within the extent; ``locate`` beside the sweep sees the mirror in it."""

        async def use(actuator: Actuator) -> None:
            if not isinstance(actuator, Sweeps):
                pytest.skip("it does not sweep")
            await self.ready(actuator)
            sweep = actuator.check_sweep(Sweep(first=20, every=-1, count=41, rate_steps_s=100))
            low, high = actuator.extent(sweep)
            assert low <= sweep.last < sweep.first <= high
            motion = await actuator.prepare_sweep(sweep)
            assert low <= motion.step <= high
            sweeping = asyncio.ensure_future(actuator.sweep(sweep))
            await asyncio.sleep(actuator.run_up_s(sweep) + 0.1)
            before = now_ns()
            sighting = await actuator.locate()
            assert low <= sighting.step <= high
            assert sighting.uncertain_ns >= 0
            assert before - sighting.uncertain_ns <= sighting.at_ns <= now_ns() + sighting.uncertain_ns + 1
            await sweeping
            assert low <= actuator.position <= sweep.last, "it stands behind the last line"

        self.run(use)

    def test_tells_when_it_begins_to_move(self) -> None:
        """`TellsStart`: ``started_ns`` is set, and not before the least latency told."""

        async def use(actuator: Actuator) -> None:
            if not isinstance(actuator, TellsStart):
                pytest.skip("it does not tell when it begins to move")
            await self.ready(actuator)
            for step in (self.travel, self.travel + 1):
                least_s = actuator.least_latency_s(step)
                motion = await actuator.move_to(step)
                assert motion.started_ns is not None
                assert least_s >= 0
                assert motion.started_ns - motion.commanded_ns >= least_s * 1e9 - 1000

        self.run(use)


def _with_pulses(sweep: Sweep) -> Sweep:
    return Sweep(sweep.first, sweep.every, sweep.count, sweep.rate_steps_s, pulses=True)


def _gives_pulses(actuator: Sweeps, sweep: Sweep) -> bool:
    try:
        actuator.check_sweep(_with_pulses(sweep))
    except UnsupportedFeature:
        return False
    return True
