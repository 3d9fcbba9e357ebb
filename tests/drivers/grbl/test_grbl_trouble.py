"""The GRBL driver on the motion core in the emulator: positions against the mirror's own, and everything that goes wrong."""

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Any

import pytest

from scanhsi.clock import run
from scanhsi.devices.errors import DeviceError, DeviceLost, DeviceTimeout, MotionFailed, OutOfRange, PositionLost
from scanhsi_grbl import GrblActuator, GrblOptions
from scanhsi_sim.twins.stepper import StepperTwin, StepperTwinSettings
from scanhsi_sim.twins.stepper_build import firmware_elf

pytestmark = pytest.mark.twin
Scenario = Callable[[StepperTwin, GrblActuator], Awaitable[None]]
PULL_OFF = 1000  # steps between the edge of the switch, the mirror's own zero, and where homing ends


def bench(scenario: Scenario, *, homed: bool = True, speed: float = 10.0, start_step: int = 30, **options: Any) -> None:
    async def main() -> None:
        settings = StepperTwinSettings(speed=speed, start_step=start_step, firmware=firmware_elf("grbl"))
        async with StepperTwin(settings) as twin:
            actuator = GrblActuator(GrblOptions(port=twin.port, settle_s=0.0, **options))
            await actuator.connect()
            try:
                if homed:
                    await actuator.home()
                await scenario(twin, actuator)
            finally:
                await actuator.close()

    run(main())


async def mirror(twin: StepperTwin) -> int:
    """Position of the mirror, in steps of the driver."""
    return (await twin.stats())["position"] - PULL_OFF


def test_steps_are_steps_of_the_mirror() -> None:
    async def scenario(twin: StepperTwin, actuator: GrblActuator) -> None:
        for step in (1, 2, -1, 777, -999, 0):
            await actuator.move_to(step)
            assert actuator.position == step == await mirror(twin)

    bench(scenario)


def test_what_it_is_comes_from_its_settings() -> None:
    async def scenario(twin: StepperTwin, actuator: GrblActuator) -> None:
        info = actuator.info
        assert info.max_rate_steps_s == 4000
        assert (info.limits.minimum, info.limits.maximum) == (
            -PULL_OFF,
            9600,
        )  # its soft limit below, the option's above
        assert info.firmware.startswith("1.1h")
        with pytest.raises(PositionLost):  # as every GRBL with a switch after power-on
            _ = actuator.position
        with pytest.raises(PositionLost):
            await actuator.move_to(1)

    bench(scenario, homed=False)


def test_backlash_is_taken_up_from_below() -> None:
    async def scenario(twin: StepperTwin, actuator: GrblActuator) -> None:
        await actuator.move_to(500)
        before = await twin.stats()
        await actuator.move_to(400)
        after = await twin.stats()
        assert (after["down"] - before["down"], after["up"] - before["up"]) == (130, 30)

    bench(scenario, backlash_steps=30)


def test_stop_keeps_the_position() -> None:
    async def scenario(twin: StepperTwin, actuator: GrblActuator) -> None:
        moving = asyncio.ensure_future(actuator.move_to(9000))
        await asyncio.sleep(0.15)
        await actuator.stop()
        with pytest.raises(MotionFailed):
            await moving
        assert 0 < actuator.position == await mirror(twin) < 9000
        await actuator.move_to(0)
        assert await mirror(twin) == 0

    bench(scenario, speed=5.0)


def test_a_reset_in_mid_move_loses_the_position() -> None:
    async def scenario(twin: StepperTwin, actuator: GrblActuator) -> None:
        moving = asyncio.ensure_future(actuator.move_to(9000))
        await asyncio.sleep(0.15)
        await twin.command("reset")
        with pytest.raises(PositionLost):
            await moving
        assert not actuator.homed
        with pytest.raises(PositionLost):
            await actuator.move_to(0)
        await actuator.stop()
        await actuator.home()
        await actuator.move_to(50)
        assert await mirror(twin) == 50

    bench(scenario, speed=5.0)


def test_stop_while_homing() -> None:
    async def scenario(twin: StepperTwin, actuator: GrblActuator) -> None:
        for cancelled in (False, True):
            homing = asyncio.ensure_future(actuator.home())
            await asyncio.sleep(0.2)
            if cancelled:
                homing.cancel()
            else:
                await actuator.stop()
            with pytest.raises((MotionFailed, PositionLost, asyncio.CancelledError)):
                await homing
            await actuator.stop()
            where = await mirror(twin)
            await asyncio.sleep(0.1)
            assert await mirror(twin) == where
            assert not actuator.homed
        await actuator.home()
        assert await mirror(twin) == 0

    bench(scenario, homed=False, speed=3.0, start_step=4000)


def test_a_home_switch_that_is_not_found() -> None:
    async def scenario(twin: StepperTwin, actuator: GrblActuator) -> None:
        for _ in range(2):
            with pytest.raises(MotionFailed, match="not found"):
                await actuator.home()
        assert not actuator.homed

    async def main() -> None:
        settings = StepperTwinSettings(speed=0, window_steps=0, firmware=firmware_elf("grbl"))
        async with StepperTwin(settings) as twin:
            actuator = GrblActuator(GrblOptions(port=twin.port))
            await actuator.connect()
            await scenario(twin, actuator)
            await actuator.close()

    run(main())


def test_unplugged_in_mid_move_and_plugged_in_again() -> None:
    async def scenario(twin: StepperTwin, actuator: GrblActuator) -> None:
        moving = asyncio.ensure_future(actuator.move_to(9000))
        await asyncio.sleep(0.2)
        await twin.command("unplug")
        with pytest.raises(DeviceLost):
            await moving
        with pytest.raises(DeviceLost):
            await actuator.stop()
        await actuator.close()
        await twin.command("plug")
        await actuator.connect()
        await actuator.home()
        await actuator.move_to(10)
        assert await mirror(twin) == 10

    bench(scenario, speed=5.0)


def test_a_lost_answer_costs_a_timeout_and_no_position() -> None:
    async def scenario(twin: StepperTwin, actuator: GrblActuator) -> None:
        await twin.command("flip tx 1")  # of the ok that follows
        with pytest.raises(DeviceTimeout):
            await actuator.move_to(300)
        assert actuator.position == await mirror(twin)
        await actuator.move_to(301)
        assert await mirror(twin) == 301

    bench(scenario, reply_timeout_s=0.3, motion_margin_s=0.5)


def test_garbled_lines_never_lie_about_the_position() -> None:
    async def scenario(twin: StepperTwin, actuator: GrblActuator) -> None:
        await twin.command("noise 30 10")  # per 10,000 bytes
        done = 0
        for step in range(0, 240, 20):
            with suppress(DeviceError):
                await actuator.move_to(step)
                assert actuator.position == step == await mirror(twin)
                done += 1
        await twin.command("noise 0 0")
        assert done > 5
        await actuator.stop()
        if not actuator.homed:
            await actuator.home()
        await actuator.move_to(33)
        assert await mirror(twin) == 33

    bench(scenario, reply_timeout_s=0.2, motion_margin_s=0.5)


def test_a_run_that_another_program_left_is_stopped_by_connect() -> None:
    async def scenario(twin: StepperTwin, actuator: GrblActuator) -> None:
        link = actuator._connected("test")
        await link.send("G0X-18")
        await actuator.close()
        await actuator.connect()
        where = await mirror(twin)
        assert 0 < where < 7000
        await asyncio.sleep(0.1)
        assert await mirror(twin) == where == actuator.position

    bench(scenario, speed=1.0)


def test_the_controllers_own_limits_hold_too() -> None:
    async def scenario(twin: StepperTwin, actuator: GrblActuator) -> None:
        with pytest.raises(OutOfRange, match="error:15"):
            await actuator._connected("test").send("$J=G53G90X1F100")
        with pytest.raises(OutOfRange):
            await actuator.move_to(-PULL_OFF - 1)
        assert await mirror(twin) == 0

    bench(scenario)


def test_without_a_switch_the_controllers_count_is_all_there_is() -> None:
    async def scenario(twin: StepperTwin, actuator: GrblActuator) -> None:
        link = actuator._connected("test")
        for setting in ("$20=0", "$22=0"):
            await link.send(setting)
        await link.send("$X")
        await actuator.close()
        await actuator.connect()
        assert not actuator.info.finds_home
        await actuator.home()
        await actuator.move_to(120)
        await actuator.close()
        await actuator.connect()  # the same controller, still counting
        assert actuator.homed
        assert actuator.position == 120
        motion = await actuator.home()
        assert motion.step == actuator.position == 0
        assert (await twin.stats())["position"] == 30
        await actuator.move_to(120)
        await twin.command("reset")
        with pytest.raises(PositionLost):
            await actuator.move_to(0)
        await actuator.close()
        await actuator.connect()
        assert not actuator.homed

    bench(scenario, homed=False)
