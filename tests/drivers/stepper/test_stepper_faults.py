"""The fault suite: driver, real firmware in the emulator, mirror model, and everything that goes wrong between them."""

import asyncio
import itertools
import statistics

import pytest
from stepper_twin import FAST, bench, request, twin_and_actuator

from scanhsi.clock import now_ns, run
from scanhsi.devices import Sweep
from scanhsi.devices.errors import DeviceBusy, DeviceError, DeviceLost, DeviceNotFound, MotionFailed, PositionLost
from scanhsi_sim.twins.stepper import CPU_HZ, StepperTwin, StepperTwinSettings
from scanhsi_stepper import StepperActuator, StepperOptions
from scanhsi_stepper.motions import run_motion
from scanhsi_stepper.ramp import Profile, move_time_s

pytestmark = pytest.mark.twin


def settings(**values: object) -> StepperTwinSettings:
    return StepperTwinSettings(**{"speed": FAST, "start_step": 0, **values})  # pyright: ignore[reportArgumentType]


# 1


def test_noise_on_the_line_loses_no_step_and_repeats_none() -> None:
    async def scenario(twin: StepperTwin, actuator: StepperActuator) -> None:
        await twin.command("noise 100 50")
        link = actuator._link
        assert link is not None
        for _ in range(50):
            for command in ("MR 3", "MR -1"):  # relative: a repeated execution would show
                assert (await run_motion(link, command, 0.003, 10.0)).reached
        await twin.command("noise 0 0")
        stats = await twin.stats()
        assert await request(actuator, "P") == ("100",)
        assert stats["position"] == 100
        assert stats["up"] == 150
        assert stats["down"] == 50
        assert stats["garbled"] + stats["dropped"] > 50
        assert actuator.counters.resends > 5

    bench(scenario, settings(), reply_timeout_s=0.03, reply_attempts=40)


# 2


def test_stop_in_motion_and_a_second_move() -> None:
    async def scenario(twin: StepperTwin, actuator: StepperActuator) -> None:
        first = asyncio.create_task(actuator.move_to(9000))
        while (await twin.stats())["up"] < 100:
            await asyncio.sleep(0.001)
        with pytest.raises(DeviceBusy, match="a motion is under way"):
            await request(actuator, "MR 5")
        await actuator.stop()
        with pytest.raises(MotionFailed, match="was stopped at step"):
            await first
        stats = await twin.stats()
        assert 100 <= actuator.position == stats["position"] < 9000
        await twin.command(f"speed {FAST}")
        await actuator.move_to(0)
        assert (await twin.stats())["position"] == 0

    bench(scenario, settings(speed=1.0))


def test_a_refused_second_move_does_not_harm_the_first() -> None:
    async def scenario(twin: StepperTwin, actuator: StepperActuator) -> None:
        first = asyncio.create_task(actuator.move_to(2000))
        while (await twin.stats())["up"] < 100:
            await asyncio.sleep(0.001)
        with pytest.raises(DeviceBusy):
            await request(actuator, "MA 7")
        assert (await first).step == 2000
        assert (await twin.stats())["position"] == 2000

    bench(scenario, settings(speed=1.0))


# 3


def test_a_lost_step_shows_in_the_mirror_only_and_homing_mends_it() -> None:
    async def scenario(twin: StepperTwin, actuator: StepperActuator) -> None:
        await twin.command("lose 40")
        await actuator.move_to(100)
        assert (actuator.position, (await twin.stats())["position"]) == (100, 99)
        await actuator.home()
        assert (await twin.stats())["position"] == 0

    bench(scenario, settings())


# 4


def test_a_second_open_is_refused_and_the_first_link_unharmed() -> None:
    async def scenario(twin: StepperTwin, actuator: StepperActuator) -> None:
        with pytest.raises(DeviceBusy, match="in use by another program"):
            await StepperActuator(StepperOptions(port=twin.port)).connect()
        await actuator.move_to(10)
        assert actuator.counters.bad_lines == actuator.counters.resends == 0

    bench(scenario, settings())


# 5


def test_a_reset_in_a_move_loses_the_position_until_homed() -> None:
    async def scenario(twin: StepperTwin, actuator: StepperActuator) -> None:
        move = asyncio.create_task(actuator.move_to(9000))
        while (await twin.stats())["up"] < 100:
            await asyncio.sleep(0.001)
        await twin.command("reset")
        with pytest.raises(PositionLost, match="restarted"):
            await move
        with pytest.raises(PositionLost):
            await actuator.move_to(5)
        where = (await twin.stats())["position"]
        await actuator.stop()
        assert (await twin.stats())["position"] == where  # it stands
        await twin.command(f"speed {FAST}")
        await actuator.home()
        await actuator.move_to(64)
        assert (await twin.stats())["position"] == 64

    bench(scenario, settings(speed=1.0))


def test_a_reset_between_request_and_retry_executes_nothing_twice() -> None:
    async def scenario(twin: StepperTwin, actuator: StepperActuator) -> None:
        await twin.command("flip tx 1")  # the OK of the move is damaged: the driver will want to repeat it
        move = asyncio.create_task(request(actuator, "MR 8"))
        while (await twin.stats())["up"] < 8:
            await asyncio.sleep(0.001)
        await twin.command("reset")
        with pytest.raises(PositionLost):
            await move
        await asyncio.sleep(0.2)
        assert (await twin.stats())["up"] == 8

    bench(scenario, settings(), reply_timeout_s=3.0)


# 6


def test_unplugging_in_a_move_and_plugging_in_again() -> None:
    async def scenario(twin: StepperTwin, actuator: StepperActuator) -> None:
        move = asyncio.create_task(actuator.move_to(9000))
        while (await twin.stats())["up"] < 100:
            await asyncio.sleep(0.001)
        await twin.command("unplug")
        with pytest.raises(DeviceLost, match="connection is gone"):
            await move
        for call in (lambda: actuator.move_to(1), actuator.home, actuator.stop):
            with pytest.raises(DeviceLost):
                await call()
        with pytest.raises(DeviceNotFound, match="no such port"):
            await actuator.connect()
        await twin.command("plug")
        await actuator.connect()
        await twin.command(f"speed {FAST}")
        await actuator.home()
        assert (await twin.stats())["position"] == 0

    bench(scenario, settings(speed=1.0))


# 7


def test_wrong_baud_rate() -> None:
    async def main() -> None:
        async with StepperTwin(settings()) as twin:
            actuator = StepperActuator(StepperOptions(port=twin.port, baud=57_600, start_timeout_s=0.6))
            with pytest.raises(DeviceNotFound, match="nothing that speaks the stepper protocol answers"):
                await actuator.connect()
            assert (await twin.stats())["wrong_baud"] > 0

    run(main())


# 8


def test_auto_reset_on_each_open_until_hupcl_is_cleared() -> None:
    async def opened(port: str) -> tuple[float, int]:
        actuator = StepperActuator(StepperOptions(port=port, settle_s=0.0, motion_margin_s=10.0))
        began = now_ns()
        await actuator.connect()
        waited_s = (now_ns() - began) / 1e9
        position = actuator.position
        await actuator.move_to(12)
        await actuator.close()
        return waited_s, position

    async def until_closed(twin: StepperTwin) -> None:
        while (await twin.stats())["attached"]:
            await asyncio.sleep(0.001)

    async def main() -> None:
        async with StepperTwin(settings(speed=1.0, auto_reset_s=0.6)) as twin:
            for _ in range(2):
                waited_s, position = await opened(twin.port)
                await until_closed(twin)
                assert waited_s > 0.6
                assert position == 0
            process = await asyncio.create_subprocess_exec("stty", "-F", twin.port, "-hupcl")
            assert await process.wait() == 0
            await until_closed(twin)
            await opened(twin.port)
            await until_closed(twin)
            assert (await opened(twin.port))[1] == 12  # kept: no reset

    run(main())


# 9


def test_queries_during_a_long_move_disturb_neither() -> None:
    async def scenario(twin: StepperTwin, actuator: StepperActuator) -> None:
        await twin.command("stats-reset")
        move = asyncio.create_task(actuator.move_to(9000))
        asked = 0
        while not move.done():
            await request(actuator, "Q")
            asked += 1
        assert (await move).step == 9000
        stats = await twin.stats()
        assert asked > 10
        assert stats["overruns"] == 0
        assert [stats[f"breach_{kind}"] for kind in ("period", "high", "low", "setup")] == [0, 0, 0, 0]
        assert (stats["up"], stats["down"]) == (9000, 0)
        words = await request(actuator, "Q")
        assert words[6:] == ("0", "0")
        assert stats["min_period"] > CPU_HZ / 4000 * 0.97
        assert stats["min_high"] >= 31
        assert stats["min_setup"] >= 20e-6 * CPU_HZ

    bench(scenario, settings(speed=3.0))


# 10


@pytest.mark.parametrize("speed", [1.0, FAST])
def test_a_sweep_triggers_at_exact_positions_and_constant_intervals(speed: float) -> None:
    async def scenario(twin: StepperTwin, actuator: StepperActuator) -> None:
        sweep = actuator.check_sweep(Sweep(first=1000, every=16, count=200, rate_steps_s=4000, pulses=True))
        await actuator.prepare_sweep(sweep)
        motion = await actuator.sweep(sweep)
        assert motion.pulses == 200
        assert [trigger.position for trigger in twin.triggers] == [1000 + 16 * i for i in range(200)]
        assert [trigger.number for trigger in twin.triggers] == list(range(1, 201))
        cycles = [trigger.cycle for trigger in twin.triggers]
        intervals_us = [(b - a) * 1e6 / CPU_HZ for a, b in itertools.pairwise(cycles)]
        assert statistics.mean(intervals_us) == pytest.approx(4000, abs=0.01)
        assert statistics.pstdev(intervals_us) < 0.5
        stats = await twin.stats()
        assert actuator.position == stats["position"]
        assert 50 * 16 <= stats["min_trigger"] <= stats["max_trigger"] < 60 * 16

    bench(scenario, settings(speed=speed, trigger_lines=True))


def test_a_sweep_downwards_and_one_of_every_step() -> None:
    async def scenario(twin: StepperTwin, actuator: StepperActuator) -> None:
        for first, every, count, rate in ((500, -7, 30, 1000), (-300, 1, 100, 333), (0, 3, 1, 4000)):
            sweep = actuator.check_sweep(Sweep(first, every, count, rate, pulses=True))
            twin.triggers.clear()
            await actuator.prepare_sweep(sweep)
            assert (await actuator.sweep(sweep)).pulses == count
            assert [trigger.position for trigger in twin.triggers] == [first + every * i for i in range(count)]
            assert actuator.position == (await twin.stats())["position"]

    bench(scenario, settings(trigger_lines=True))


# 11


@pytest.mark.parametrize("direction", [-1, 1])
def test_homing_always_finds_the_same_edge(direction: int) -> None:
    edge = 0 if direction < 0 else -39

    async def scenario(twin: StepperTwin, actuator: StepperActuator) -> None:
        for start in (1234, -1234, 9600, 1, 0, -20, -39, -40, 7001):
            await twin.command(f"mirror {start}")
            await actuator.home()
            assert actuator.position == 0
            assert ((await twin.stats())["position"] - edge) % 19_200 == 0, start

    bench(scenario, settings(), home_direction=direction, start_speed_steps_s=0)


def test_homing_at_full_speed_overshoots_and_comes_back() -> None:
    async def scenario(twin: StepperTwin, actuator: StepperActuator) -> None:
        await twin.command("mirror 9000")
        await actuator.home()
        assert (await twin.stats())["position"] == 0
        assert await request(actuator, "V") == ("12000",)  # the slow latch has not left its mark
        await twin.command("stats-reset")
        await actuator.move_to(5000)
        assert (await twin.stats())["min_period"] < CPU_HZ / 11_500

    bench(scenario, settings(), top_speed_steps_s=12_000, acceleration_steps_s2=40_000)


def test_homing_without_a_sensor_fails_within_its_limit() -> None:
    async def scenario(twin: StepperTwin, actuator: StepperActuator) -> None:
        with pytest.raises(MotionFailed, match="home sensor was not found"):
            await actuator.home()
        assert not actuator.homed
        assert (await twin.stats())["down"] == 2000

    bench(scenario, settings(window_steps=0), home_limit_steps=2000)


def test_stop_while_homing() -> None:
    async def scenario(twin: StepperTwin, actuator: StepperActuator) -> None:
        await twin.command("mirror 9000")
        home = asyncio.create_task(actuator.home())
        while (await twin.stats())["down"] < 500:
            await asyncio.sleep(0.001)
        await actuator.stop()
        with pytest.raises(MotionFailed, match="was stopped"):
            await home
        assert not actuator.homed
        assert await request(actuator, "V") == ("4000",)

    bench(scenario, settings(speed=1.0))


# 12


def test_move_times_are_those_of_the_table_in_simulated_cycles() -> None:
    async def scenario(twin: StepperTwin, actuator: StepperActuator) -> None:
        position = 0
        for top, acceleration, start in (
            (4000, 20_000, 0),
            (4000, 20_000, 2000),
            (4000, 1000, 0),
            (12_000, 100_000, 0),
            (333, 500, 50),
        ):
            for command in (f"V {top}", f"A {acceleration}", f"B {start}"):
                await request(actuator, command)
            for steps in (1, 2, 4, 8, 16, 64, 700):
                await twin.command("stats-reset")
                link = actuator._link
                assert link is not None
                running = await link.start(f"MR {steps}")
                end = (await running.end).message
                position += steps
                assert end.position == position
                stats = await twin.stats()
                expected_s = move_time_s(steps, Profile(top, acceleration, start))
                measured_s = (stats["last_step"] - stats["first_step"]) / CPU_HZ + 20e-6
                assert measured_s == pytest.approx(expected_s, rel=2e-3, abs=60e-6), (top, acceleration, start, steps)
                assert end.us * 1e-6 == pytest.approx(measured_s, abs=60e-6)

    bench(scenario, settings(speed=0))


# 13: what a scripted controller shows better is in test_stepper_link.py


def test_the_emulator_dying_is_a_lost_device() -> None:
    async def scenario(twin: StepperTwin, actuator: StepperActuator) -> None:
        move = asyncio.create_task(actuator.move_to(9000))
        while (await twin.stats())["up"] < 100:
            await asyncio.sleep(0.001)
        await twin.command("quit")
        with pytest.raises(DeviceLost):
            await move
        with pytest.raises(DeviceError):
            await actuator.stop()
        with pytest.raises(DeviceLost, match="has ended"):
            await twin.command("stats")

    bench(scenario, settings(speed=1.0))


def test_closing_stops_the_motor() -> None:
    async def main() -> None:
        async with twin_and_actuator(settings(speed=1.0)) as (twin, actuator):
            move = asyncio.create_task(actuator.move_to(9000))
            while (await twin.stats())["up"] < 100:
                await asyncio.sleep(0.001)
            await actuator.close()
            where = (await twin.stats())["position"]
            with pytest.raises(DeviceError):
                await move
            assert where < 9000
            await asyncio.sleep(0.1)
            assert (await twin.stats())["position"] == where

    run(main())


def test_connecting_stops_a_motion_that_was_left_running() -> None:
    async def main() -> None:
        async with twin_and_actuator(settings(speed=1.0)) as (twin, actuator):
            link = actuator._link
            assert link is not None
            await link.start("MA 9000")
            assert actuator._transport is not None
            actuator._transport.abort()  # as if the program had been killed
            await link.lost.wait()
            await actuator.connect()
            assert actuator.position == (await twin.stats())["position"] < 9000

    run(main())
