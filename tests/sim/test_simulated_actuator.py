"""The simulated actuator against its contract, in virtual time, to the ns; and together with the camera."""

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import scanhsi_sim
from scanhsi.clock import now_ns, run_virtual
from scanhsi.devices import CameraSettings, Frame, PixelFormat, Role, Sweep, Sweeps, Trigger, find
from scanhsi.devices.errors import DeviceBusy, DeviceError, MotionFailed, OutOfRange
from scanhsi.timing.delays import DelayStreams, load_profile
from scanhsi_sim import ActuatorOptions, CameraOptions, actuator_backend, camera_backend
from scanhsi_sim.actuator import SimulatedActuator
from scanhsi_sim.bench import bench
from scanhsi_sim.options import find_profile
from scanhsi_sim.scenes.testpattern import Decoded, decode

PROFILE = load_profile(Path(scanhsi_sim.__file__).parent / "profiles" / "sensors2019.json")
S = 1_000_000_000


def virtually(main: Callable[[], Awaitable[Any]]) -> Any:
    async def wrapped() -> Any:
        return await main()

    return run_virtual(wrapped())


async def connected(**options: Any) -> SimulatedActuator:
    made = actuator_backend.create(ActuatorOptions(**options))
    assert isinstance(made, SimulatedActuator)
    await made.connect()
    return made


def cost_ns(line: int, steps: int, seed: int = 0) -> int:
    streams = DelayStreams(PROFILE, seed)
    return streams.delay_ns("T_rand", line) + streams.delay_ns("T_act", line, steps=steps)


def test_a_move_costs_what_the_profile_says_for_its_line_and_length() -> None:
    async def main() -> None:
        device = await connected(seed=3, bench="moves")
        for line, step in ((0, 1), (0, 5), (7, 2)):
            bench("moves").exposures = line
            before, began = device.position, now_ns()
            motion = await device.move_to(step)
            assert motion.commanded_ns == began
            assert motion.moved_ns == now_ns() == began + cost_ns(line, abs(step - before), seed=3)
            assert motion.step == device.position == step
        await device.close()

    virtually(main)


def test_the_mirror_stands_still_until_the_command_has_come_through() -> None:
    async def main() -> None:
        device = await connected(bench="still")
        mirror = bench("still").mirror
        motion = await device.move_to(100)
        streams = DelayStreams(PROFILE, 0)
        waits = streams.delay_ns("T_rand", 0) + streams.delay_ns("T_cmd", 0)
        assert motion.started_ns == motion.commanded_ns + waits
        assert waits >= device.least_latency_s(100) * 1e9 > 0
        assert mirror.position(motion.commanded_ns + waits) == 0
        assert 0 < mirror.position(motion.commanded_ns + waits + 1_000_000) < 100
        assert mirror.position(motion.moved_ns - 1) < 100
        assert mirror.position(motion.moved_ns) == 100
        await device.close()

    virtually(main)


def test_homing() -> None:
    async def main() -> None:
        device = await connected(home_s=1.5)
        assert (device.homed, device.position) == (False, 0)
        await device.move_to(40)
        began = now_ns()
        motion = await device.home()
        assert now_ns() - began == 1.5 * S
        assert (motion.step, device.position, device.homed) == (0, 0, True)
        await device.close()

    virtually(main)


def test_targets_outside_the_limits_are_refused_before_anything_moves() -> None:
    async def main() -> None:
        device = await connected(limits=(-10, 600))
        with pytest.raises(OutOfRange, match="step 601 steps is not allowed; allowed is -10 to 600 steps"):
            await device.move_to(601)
        assert now_ns() == 0
        assert device.position == 0
        await device.close()

    virtually(main)


def test_stop_ends_a_move_where_the_mirror_is() -> None:
    async def main() -> None:
        device = await connected(bench="stopped")
        moving = asyncio.create_task(device.move_to(2000))
        await asyncio.sleep(0.25)
        await device.stop()
        with pytest.raises(MotionFailed, match=r"stopped at step \d+"):
            await moving
        assert 500 < device.position < 1500
        assert bench("stopped").mirror.position(now_ns() + S) == device.position
        for _ in range(3):
            await device.stop()
        assert (await device.move_to(3)).step == 3
        await device.close()

    virtually(main)


def test_after_a_cancelled_move_the_mirror_moves_until_stopped() -> None:
    async def main() -> None:
        device = await connected(bench="cancelled")
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.1):
                await device.move_to(2000)
        first = bench("cancelled").mirror.position(now_ns())
        await asyncio.sleep(0.05)
        assert bench("cancelled").mirror.position(now_ns()) > first
        with pytest.raises(DeviceBusy, match="still moving"):
            await device.move_to(0)
        await device.stop()
        assert device.position == bench("cancelled").mirror.position(now_ns() + S)
        await device.move_to(0)
        await device.close()

    virtually(main)


def test_stop_and_close_work_in_any_state() -> None:
    async def main() -> None:
        device = actuator_backend.create(ActuatorOptions())
        await device.stop()
        await device.close()
        with pytest.raises(DeviceError, match="not connected"):
            await device.move_to(1)
        await device.connect()
        await device.close()
        await device.close()

    virtually(main)


SWEEP = Sweep(first=-20, every=1, count=41, rate_steps_s=8.0, pulses=True)


@pytest.mark.parametrize(
    "sweep", [SWEEP, replace(SWEEP, first=40, every=-2, rate_steps_s=16.0), replace(SWEEP, rate_steps_s=1000.0)]
)
def test_a_sweep_gives_its_pulses_exactly_where_the_mirror_passes(sweep: Sweep) -> None:
    async def main() -> None:
        device = await connected(bench="sweep")
        here = bench("sweep")
        passed: list[tuple[int, float]] = []
        here.trigger = lambda when: passed.append((when, here.mirror.position(when)))
        assert device.check_sweep(sweep) == sweep
        await device.prepare_sweep(sweep)
        began = now_ns()
        motion = await device.sweep(sweep)
        places = [sweep.first + sweep.every * line for line in range(sweep.count)]
        assert [place for _, place in passed] == pytest.approx(places, abs=1e-5)
        assert motion.pulses == sweep.count
        assert motion.commanded_ns == passed[0][0]
        assert (motion.commanded_ns - began) * 1e-9 == pytest.approx(device.run_up_s(sweep), abs=0.02)
        period_ns = abs(sweep.every) / sweep.rate_steps_s * 1e9
        assert np.diff([when for when, _ in passed]) == pytest.approx(period_ns, abs=1)
        assert device.position == motion.step == here.mirror.position(now_ns())
        assert (motion.step - sweep.last) * sweep.every > 0
        await device.close()

    virtually(main)


def test_a_sweep_that_cannot_be_done_is_refused() -> None:
    async def main() -> None:
        device = await connected(limits=(-100, 100))
        with pytest.raises(OutOfRange, match="sweep rate 4001 steps/s"):
            device.check_sweep(replace(SWEEP, rate_steps_s=4001))
        with pytest.raises(OutOfRange, match="start of the run-up -101 steps"):
            device.check_sweep(replace(SWEEP, first=-100))
        with pytest.raises(OutOfRange, match="end of the run-out 102 steps"):
            device.check_sweep(replace(SWEEP, first=60))
        with pytest.raises(DeviceError, match="not prepared"):
            await device.sweep(SWEEP)
        assert now_ns() == 0
        await device.close()

    virtually(main)


def test_stop_ends_a_sweep_and_its_pulses() -> None:
    async def main() -> None:
        device = await connected(bench="halted")
        pulses: list[int] = []
        bench("halted").trigger = pulses.append
        await device.prepare_sweep(SWEEP)
        sweeping = asyncio.create_task(device.sweep(SWEEP))
        await asyncio.sleep(2)
        await device.stop()
        with pytest.raises(MotionFailed):
            await sweeping
        given = len(pulses)
        assert 10 < given < 20
        await asyncio.sleep(2)
        assert len(pulses) == given
        await device.close()

    virtually(main)


async def _pair(name: str, trigger: Trigger, exposure_s: float) -> tuple[Any, SimulatedActuator]:
    camera = camera_backend.create(CameraOptions(bench=name, scene="testpattern", bands=8, samples=16))
    actuator = await connected(bench=name)
    await camera.connect()
    await camera.configure(CameraSettings(exposure_s, 0, PixelFormat.MONO12))
    await camera.arm(trigger, 16)
    return camera, actuator


async def _pixels(camera: Any, count: int) -> list[Decoded]:
    out, seen = np.zeros((8, 16), np.uint16), []
    stream = camera.frames()
    while len(seen) < count:
        frame = await anext(stream)
        assert isinstance(frame, Frame)
        await camera.unpack(frame, out)
        seen.append(decode(out))
    return seen


def test_a_sweep_triggers_the_camera_of_its_bench_at_each_line() -> None:
    async def main() -> None:
        camera, actuator = await _pair("together", Trigger.LINE, 0.1)
        await actuator.prepare_sweep(SWEEP)
        sweeping = asyncio.create_task(actuator.sweep(SWEEP))
        seen = await _pixels(camera, SWEEP.count)
        # Each exposure begins exactly on its step and is smeared by the motion, as the pattern says.
        assert seen == [Decoded((-20 + line) % 4096, moved=True) for line in range(SWEEP.count)]
        await sweeping
        await camera.close()
        await actuator.close()

    virtually(main)


def test_moving_after_the_exposure_never_smears_and_moving_within_it_always_does() -> None:
    async def main() -> None:
        camera, actuator = await _pair("interlock", Trigger.SOFTWARE, 0.03)
        for line in range(6):
            await actuator.move_to(line)
            await camera.expose()
        assert await _pixels(camera, 6) == [Decoded(line, moved=False) for line in range(6)]
        for line in range(6, 9):
            exposing = asyncio.create_task(camera.expose())
            await asyncio.sleep(0.01)
            await actuator.move_to(line)
            await exposing
        assert await _pixels(camera, 3) == [Decoded(line - 1, moved=True) for line in range(6, 9)]
        await camera.close()
        await actuator.close()

    virtually(main)


def test_all_modes_see_the_same_delays() -> None:
    """A move costs what its line costs, whether it is commanded after the exposure or after the frame."""

    async def scan(wait_for_frame: bool) -> list[int]:
        camera, actuator = await _pair("modes", Trigger.SOFTWARE, 0.05)
        stream, costs = camera.frames(), []
        for line in range(8):
            if line:
                motion = await actuator.move_to(line)
                costs.append(motion.moved_ns - motion.commanded_ns)
            await camera.expose()
            if wait_for_frame:
                await anext(stream)
        await camera.close()
        await actuator.close()
        return costs

    stepped, sequential = virtually(lambda: scan(False)), virtually(lambda: scan(True))
    assert stepped == sequential == [cost_ns(line, 1) for line in range(1, 8)]


def test_it_is_found_by_its_entry_point_and_says_what_it_is() -> None:
    async def main() -> None:
        device = await connected()
        info = device.info
        assert info.simulated
        assert (info.steps_per_revolution, info.backlash_steps) == (19_200, 0)
        assert PROFILE.mark in info.firmware
        assert isinstance(device, Sweeps)
        await device.close()

    assert find(Role.ACTUATOR, "simulated") is actuator_backend
    assert actuator_backend.virtual_time
    assert actuator_backend.capabilities == ("Sweeps", "TellsStart")
    assert all(field.description for field in ActuatorOptions.model_fields.values())
    assert find_profile("sensors2019") == PROFILE
    virtually(main)
