"""The actuator's own logic against a scripted controller, in virtual time."""

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

import pytest
from pydantic import ValidationError
from stepper_peer import Controller, connect

import scanhsi_stepper.actuator as actuator_module
from scanhsi.clock import now_ns, run_virtual
from scanhsi.devices import Actuator, Role, Sweep, Sweeps, find
from scanhsi.devices.errors import (
    DeviceBusy,
    DeviceError,
    DeviceLost,
    DeviceNotFound,
    DeviceTimeout,
    MotionFailed,
    OutOfRange,
    PositionLost,
    ProtocolError,
)
from scanhsi_stepper import StepperActuator, StepperOptions, backend

Scenario = Callable[[StepperActuator, Controller], Awaitable[None]]


@pytest.fixture
def play(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Controller]:
    """Run a scenario with an actuator whose port leads to a scripted controller."""

    def run_it(
        scenario: Scenario, controller: Controller | None = None, *, connected: bool = True, **options: Any
    ) -> Controller:
        peer = controller or Controller()

        async def open_in_memory(port: str, baud: int, factory: Callable[[], Any], device: str) -> Any:
            link = factory()
            return connect(peer, link), link

        monkeypatch.setattr(actuator_module, "open_port", open_in_memory)

        async def main() -> None:
            actuator = StepperActuator(StepperOptions(port="mem", **options))
            if connected:
                await actuator.connect()
            await scenario(actuator, peer)
            await actuator.close()

        run_virtual(main())
        return peer

    return run_it


def test_backend_is_found_by_its_entry_point_and_can_sweep() -> None:
    assert find(Role.ACTUATOR, "stepper") is backend
    assert backend.capabilities == ("Sweeps", "TellsStart")
    assert issubclass(StepperActuator, Sweeps)
    checked_by_pyright: type[Actuator] = StepperActuator
    assert checked_by_pyright is backend.device


def test_options_are_checked() -> None:
    with pytest.raises(ValidationError, match="minimum_step 5 is not below maximum_step 5"):
        StepperOptions(port="x", minimum_step=5, maximum_step=5)
    with pytest.raises(ValidationError, match="Extra inputs"):
        StepperOptions.model_validate({"port": "x", "sped": 3})
    assert all(field.description for field in StepperOptions.model_fields.values())


def test_connect_sets_the_controller_up_and_moves_nothing(play: Any) -> None:
    async def scenario(actuator: StepperActuator, peer: Controller) -> None:
        assert peer.executed == ["I", "S", "Q", "E 1", "A 7000", "B 2000", "V 3000"]
        assert (actuator.position, actuator.homed) == (17, False)
        assert actuator.info.model == "scanhsi-stepper 328P"
        assert actuator.info.max_rate_steps_s == 3000
        with pytest.raises(DeviceBusy, match="already connected"):
            await actuator.connect()

    play(scenario, Controller(position=17), top_speed_steps_s=3000, acceleration_steps_s2=7000)


def test_connect_waits_for_a_bootloader(play: Any) -> None:
    async def scenario(actuator: StepperActuator, peer: Controller) -> None:
        def wake() -> None:
            peer.deaf = False
            peer.boot()

        asyncio.get_running_loop().call_later(1.6, wake)
        began = now_ns()
        await actuator.connect()
        assert 1.6e9 < now_ns() - began < 2.0e9
        assert actuator.position == 0

    play(scenario, Controller(deaf=True), connected=False)


def test_connect_gives_up_with_a_hint(play: Any) -> None:
    async def scenario(actuator: StepperActuator, peer: Controller) -> None:
        with pytest.raises(DeviceNotFound, match=r"waited 2.5 s.*is the firmware flashed"):
            await actuator.connect()
        assert peer.transport is not None
        assert peer.transport.closing

    play(scenario, Controller(deaf=True), connected=False)


def test_unreadable_answers_suggest_the_baud_rate(play: Any) -> None:
    async def scenario(actuator: StepperActuator, peer: Controller) -> None:
        with pytest.raises(DeviceNotFound, match="unreadable lines.*wrong baud rate"):
            await actuator.connect()

    play(scenario, Controller(towards_host=lambda data: [b"\xfd\x81" * 9 + b"\n"]), connected=False)


def test_other_firmware_is_refused(play: Any) -> None:
    async def scenario(actuator: StepperActuator, peer: Controller) -> None:
        with pytest.raises(ProtocolError, match="'scanhsi-stepper 2 328P'.*speaks to scanhsi-stepper 1"):
            await actuator.connect()

    play(scenario, Controller(identity="scanhsi-stepper 2 328P"), connected=False)


def test_a_move_returns_after_settling_with_stamps(play: Any) -> None:
    async def scenario(actuator: StepperActuator, peer: Controller) -> None:
        began = now_ns()
        motion = await actuator.move_to(100)
        assert motion.step == actuator.position == peer.position == 100
        assert motion.commanded_ns == began
        assert motion.moved_ns == now_ns()
        assert motion.moved_ns - began >= 100_000_000 + 500_000_000
        again = await actuator.move_to(100)
        assert again.moved_ns - again.commanded_ns < 100_000_000  # it stood still: nothing rings

    play(scenario, settle_s=0.5)


def test_the_begin_of_a_motion_is_never_told_too_late(play: Any) -> None:
    """When its command had come over the wire: what comes back may be any time late."""

    async def scenario(actuator: StepperActuator, peer: Controller) -> None:
        for step in (5, 100, -7):
            least_s = actuator.least_latency_s(step)
            motion = await actuator.move_to(step)
            assert motion.started_ns is not None
            assert (motion.started_ns - motion.commanded_ns) * 1e-9 == pytest.approx(least_s, abs=1e-9)
            assert 13 * 10 / 115_200 <= least_s <= 20 * 10 / 115_200  # >1 MA 5*CRC to >65535 MA 100*CRC

    play(scenario, backlash_steps=3)


def test_limits_are_checked_before_anything_moves(play: Any) -> None:
    async def scenario(actuator: StepperActuator, peer: Controller) -> None:
        for step in (-101, 201):
            with pytest.raises(OutOfRange, match="allowed is -100 to 200 steps"):
                await actuator.move_to(step)

    peer = play(scenario, minimum_step=-100, maximum_step=200)
    assert not any(command.startswith("MA") for command in peer.executed)


def test_backlash_is_taken_out_from_below(play: Any) -> None:
    async def scenario(actuator: StepperActuator, peer: Controller) -> None:
        await actuator.move_to(50)
        await actuator.move_to(20)

    peer = play(scenario, backlash_steps=10)
    assert [command for command in peer.executed if command.startswith("MA")] == ["MA 50", "MA 10", "MA 20"]


def test_stop_during_a_move(play: Any) -> None:
    async def scenario(actuator: StepperActuator, peer: Controller) -> None:
        move = asyncio.create_task(actuator.move_to(5000))
        await asyncio.sleep(0.5)
        await actuator.stop()
        with pytest.raises(MotionFailed, match="was stopped at step 0"):
            await move
        await actuator.stop()
        await actuator.move_to(10)

    play(scenario)


def test_a_cancelled_move_can_be_stopped(play: Any) -> None:
    async def scenario(actuator: StepperActuator, peer: Controller) -> None:
        move = asyncio.create_task(actuator.move_to(5000))
        await asyncio.sleep(0.5)
        move.cancel()
        with pytest.raises(asyncio.CancelledError):
            await move
        with pytest.raises(DeviceBusy):
            await actuator.move_to(1)
        await actuator.stop()
        assert peer.mode == 0
        await actuator.move_to(1)

    play(scenario)


def test_stop_without_ramp_loses_the_position(play: Any) -> None:
    async def scenario(actuator: StepperActuator, peer: Controller) -> None:
        peer.never_ends = True
        move = asyncio.create_task(actuator.move_to(5000))
        await asyncio.sleep(0.1)
        await actuator.stop()
        with pytest.raises(MotionFailed):
            await move
        with pytest.raises(PositionLost):
            await actuator.move_to(1)

    assert "X" in play(scenario).executed


def test_an_overdue_motion_is_stopped(play: Any) -> None:
    async def scenario(actuator: StepperActuator, peer: Controller) -> None:
        peer.never_ends = True
        with pytest.raises(DeviceTimeout, match="does not end"):
            await actuator.move_to(50)

    assert "S" in play(scenario).executed


def test_home_makes_zero_known(play: Any) -> None:
    async def scenario(actuator: StepperActuator, peer: Controller) -> None:
        motion = await actuator.home()
        assert (motion.step, actuator.position, actuator.homed) == (0, 0, True)

    assert "H 1 500" in play(scenario, Controller(position=30), home_direction=1, home_limit_steps=500).executed


def test_home_without_a_switch_takes_the_present_place(play: Any) -> None:
    async def scenario(actuator: StepperActuator, peer: Controller) -> None:
        assert (actuator.position, actuator.homed) == (30, True)  # the controller's count is all there is
        await actuator.home()
        assert (actuator.position, actuator.homed) == (0, True)

    assert "Z 0" in play(scenario, Controller(position=30), home_direction="none").executed


def test_home_without_finding_the_sensor(play: Any) -> None:
    async def scenario(actuator: StepperActuator, peer: Controller) -> None:
        with pytest.raises(MotionFailed, match="home sensor was not found"):
            await actuator.home()
        assert not actuator.homed

    play(scenario, Controller(home_found=False))


def test_after_a_restart_only_homing_helps(play: Any) -> None:
    async def scenario(actuator: StepperActuator, peer: Controller) -> None:
        await actuator.home()
        move = asyncio.create_task(actuator.move_to(5000))
        await asyncio.sleep(0.5)
        peer.boot()
        with pytest.raises(PositionLost, match="restarted"):
            await move
        with pytest.raises(PositionLost, match="move_to 5: the controller has restarted"):
            await actuator.move_to(5)
        with pytest.raises(PositionLost):
            _ = actuator.position
        assert not actuator.homed
        await actuator.stop()
        peer.executed.clear()
        await actuator.home()
        assert peer.executed == ["E 1", "A 20000", "B 2000", "V 4000", "H -1 21000"]  # the restart forgot the settings
        await actuator.move_to(5)

    play(scenario)


def test_stop_survives_a_restart_in_between(play: Any) -> None:
    async def scenario(actuator: StepperActuator, peer: Controller) -> None:
        peer.towards_host = lambda data: [data] if b"BOOT" in data else []
        asyncio.get_running_loop().call_later(0.1, peer.boot)
        asyncio.get_running_loop().call_later(0.105, setattr, peer, "towards_host", lambda data: [data])
        await actuator.stop()
        with pytest.raises(PositionLost):
            await actuator.move_to(1)

    play(scenario)


def test_a_lost_port_and_connecting_again(play: Any) -> None:
    async def scenario(actuator: StepperActuator, peer: Controller) -> None:
        move = asyncio.create_task(actuator.move_to(5000))
        await asyncio.sleep(0.5)
        assert peer.transport is not None
        peer.transport.lose(OSError(5, "Input/output error"))
        with pytest.raises(DeviceLost, match="Input/output error"):
            await move
        with pytest.raises(DeviceLost):
            await actuator.stop()
        peer.boot()
        await actuator.connect()
        await actuator.move_to(3)
        assert actuator.position == 3

    play(scenario)


def test_everything_but_close_needs_a_connection(play: Any) -> None:
    async def scenario(actuator: StepperActuator, peer: Controller) -> None:
        for call in (actuator.home, actuator.stop, lambda: actuator.move_to(0)):
            with pytest.raises(DeviceError, match="not connected"):
                await call()
        with pytest.raises(DeviceError, match="not connected"):
            _ = actuator.info
        await actuator.close()

    play(scenario, connected=False)


SWEEP = Sweep(first=1000, every=10, count=21, rate_steps_s=1000.9, pulses=True)


def test_a_sweep_with_pulses(play: Any) -> None:
    async def scenario(actuator: StepperActuator, peer: Controller) -> None:
        sweep = actuator.check_sweep(SWEEP)
        assert sweep.rate_steps_s == 1000
        assert 0.004 < actuator.run_up_s(sweep) < 0.008  # 4 intervals of 1 ms, and the request
        await actuator.prepare_sweep(sweep)
        assert actuator.position == 995  # 1000 steps/s is below the start speed: 1 + 4 steps of run-up
        motion = await actuator.sweep(sweep)
        assert motion.pulses == 21
        assert motion.step == actuator.position
        await actuator.move_to(0)

    peer = play(scenario)
    speeds_and_motions = [command for command in peer.executed if command[0] in "VMW"]
    assert speeds_and_motions == ["V 4000", "MA 995", "V 1000", "W 1000 10 21 50", "V 4000", "MA 0"]


def test_a_sweep_without_pulses_gives_none(play: Any) -> None:
    async def scenario(actuator: StepperActuator, peer: Controller) -> None:
        sweep = Sweep(first=-100, every=-5, count=11, rate_steps_s=500)
        await actuator.prepare_sweep(sweep)
        motion = await actuator.sweep(sweep)
        assert (motion.step, motion.pulses) == (-155, 0)
        assert motion.commanded_ns > 0

    assert "MA -155" in play(scenario).executed


@pytest.mark.parametrize(
    ("sweep", "message"),
    [
        (Sweep(0, 16, 100, 4001), "allowed is 1 to 4000 steps/s"),
        (Sweep(0, 16, 100, 0.5), "allowed is 1 to 4000 steps/s"),
        (Sweep(-9600, 1, 10, 100), "run-up -9605 steps is not allowed"),
        (Sweep(9000, 60, 10, 4000), "run-out"),
        (Sweep(0, 1, 10, 4000, pulses=True), "run into each other"),
        (Sweep(0, 0, 10, 100), "0 steps apart"),
        (Sweep(0, 1, 0, 100), "number of lines"),
    ],
)
def test_impossible_sweeps_are_refused(sweep: Sweep, message: str) -> None:
    with pytest.raises(OutOfRange, match=message):
        StepperActuator(StepperOptions(port="x", trigger_width_us=300)).check_sweep(sweep)


def test_a_sweep_has_to_be_prepared(play: Any) -> None:
    async def scenario(actuator: StepperActuator, peer: Controller) -> None:
        with pytest.raises(DeviceError, match="not prepared"):
            await actuator.sweep(SWEEP)
        await actuator.prepare_sweep(SWEEP)
        await actuator.move_to(0)
        with pytest.raises(DeviceError, match="not prepared"):
            await actuator.sweep(SWEEP)

    play(scenario)


def test_a_sweep_whose_done_is_lost_still_counts_its_pulses(play: Any) -> None:
    async def scenario(actuator: StepperActuator, peer: Controller) -> None:
        await actuator.prepare_sweep(SWEEP)
        peer.towards_host = lambda data: [] if b"DONE" in data else [data]
        assert (await actuator.sweep(SWEEP)).pulses == 21
        assert actuator.counters.done_by_poll == 1

    play(scenario)
