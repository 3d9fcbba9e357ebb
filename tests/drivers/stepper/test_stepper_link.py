"""The conversation with a scripted controller, in virtual time: loss, noise, duplicates, restarts, a port that goes away."""

import asyncio
import random
from collections.abc import Awaitable, Callable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from stepper_peer import Controller, MemoryTransport, connect, line

from scanhsi.clock import now_ns, run_virtual
from scanhsi.devices.errors import DeviceBusy, DeviceLost, DeviceTimeout, PositionLost, ProtocolError
from scanhsi_stepper.link import StepperLink
from scanhsi_stepper.motions import halt, run_motion

Scenario = Callable[[StepperLink, Controller], Awaitable[None]]


def play(scenario: Scenario, controller: Controller | None = None, *, attempts: int = 4) -> StepperLink:
    """Run a scenario against a controller."""
    peer = controller or Controller()

    async def main() -> StepperLink:
        link = StepperLink("mem", attempts=attempts)
        link.attach(connect(peer, link))
        await scenario(link, peer)
        return link

    return run_virtual(main())


def transport_of(peer: Controller) -> MemoryTransport:
    assert peer.transport is not None
    return peer.transport


def test_request_returns_the_words() -> None:
    async def scenario(link: StepperLink, peer: Controller) -> None:
        assert await link.request("I") == ("scanhsi-stepper", "1", "328P")

    play(scenario)


def test_a_lost_reply_is_asked_for_again_and_nothing_is_executed_twice() -> None:
    peer = Controller()
    lost = iter([[]])
    peer.towards_host = lambda data: next(lost, [data])

    async def scenario(link: StepperLink, peer: Controller) -> None:
        began = now_ns()
        assert await link.request("MR 5") == ("5",)
        assert now_ns() - began >= 250_000_000

    assert play(scenario, peer).counters.resends == 1
    assert peer.executed == ["MR 5"]


def test_a_damaged_request_is_sent_again_at_once() -> None:
    peer = Controller()
    damaged = iter([[b">7 MX 5*3970\n"]])
    peer.towards_firmware = lambda data: next(damaged, [data])

    async def scenario(link: StepperLink, peer: Controller) -> None:
        began = now_ns()
        await link.request("MR 5")
        assert now_ns() - began < 10_000_000

    counters = play(scenario, peer).counters
    assert (counters.naks, counters.resends) == (1, 1)


def test_a_damaged_reply_is_asked_for_again_at_once_and_nothing_is_executed_twice() -> None:
    peer = Controller(step_s=1.0)
    damaged = iter([[b"<7 OX 8*09EA\n"]] * 9)  # more often than it would ask into silence
    peer.towards_host = lambda data: next(damaged, [data])

    async def scenario(link: StepperLink, peer: Controller) -> None:
        began = now_ns()
        assert await link.request("MR 5") == ("5",)
        assert now_ns() - began < 30_000_000

    assert play(scenario, peer).counters.resends == 9
    assert peer.executed == ["MR 5"]


def test_replies_that_are_all_damaged_take_no_longer_than_silence() -> None:
    peer = Controller(towards_host=lambda data: [b"<7 OX 8*09EA\n"])

    async def scenario(link: StepperLink, peer: Controller) -> None:
        began = now_ns()
        with pytest.raises(DeviceTimeout, match=r"MR 5, waited 0.99\d* s: no answer to \d\d\d attempts"):
            await link.request("MR 5")
        assert now_ns() - began <= 1_000_000_000

    play(scenario, peer)
    assert peer.executed == ["MR 5"]


def test_a_restart_in_one_breath_with_a_damaged_line_is_seen() -> None:
    peer = Controller(step_s=1.0)

    def restart(data: bytes) -> list[bytes]:
        peer.last_seq = 0  # a retry would execute
        return [b"<7 OX 8*09EA\n" + line("!", "0 BOOT scanhsi-stepper 1 2")]

    peer.towards_host = restart

    async def scenario(link: StepperLink, peer: Controller) -> None:
        with pytest.raises(PositionLost, match="restarted"):
            await link.request("MR 5")

    play(scenario, peer)
    assert peer.executed == ["MR 5"]


def test_a_damaged_end_is_asked_for_at_once() -> None:
    peer = Controller()
    peer.towards_host = lambda data: [data.replace(b"DONE", b"DOME")]

    async def scenario(link: StepperLink, peer: Controller) -> None:
        began = now_ns()
        finished = await run_motion(link, "MR 100", 0.1, 2.0)
        assert (finished.reached, finished.position) == (True, 100)
        assert now_ns() - began < 120_000_000

    assert play(scenario, peer).counters.done_by_poll == 1


def test_silence_ends_in_a_timeout_that_says_how_long() -> None:
    async def scenario(link: StepperLink, peer: Controller) -> None:
        with pytest.raises(DeviceTimeout, match=r"MR 5, waited 1 s: no answer to 4 attempts"):
            await link.request("MR 5")

    play(scenario, Controller(deaf=True))


def test_done_in_the_same_chunk_as_ok_is_not_missed() -> None:
    peer = Controller(step_s=0.0)
    held: list[bytes] = []

    def both_at_once(data: bytes) -> list[bytes]:
        held.append(data)
        return [b"".join(held)] if b"DONE" in data else []

    peer.towards_host = both_at_once

    async def scenario(link: StepperLink, peer: Controller) -> None:
        running = await link.start("MR 1")
        assert running.end.result().message.position == 1

    assert play(scenario, peer).counters.resends == 0


def test_duplicates_and_debris_are_counted_and_ignored() -> None:
    peer = Controller()
    peer.towards_host = lambda data: [b"\xfd\x00optiboot\n", b"<1 O", data, data, b"\n<99 OK*0000\n"]

    async def scenario(link: StepperLink, peer: Controller) -> None:
        for _ in range(3):
            await link.request("Q")
        await asyncio.sleep(1)

    counters = play(scenario, peer).counters
    assert counters.stale == 3
    assert counters.noise >= 3
    assert counters.bad_lines == 3


def test_refusals_are_mapped() -> None:
    async def scenario(link: StepperLink, peer: Controller) -> None:
        await link.start("MR 1000")
        with pytest.raises(DeviceBusy, match="a motion is under way"):
            await link.request("MR 1")
        with pytest.raises(ProtocolError, match="does not know this command"):
            await link.request("K")

    play(scenario)


def test_a_restart_voids_the_request_and_the_motion_and_is_never_retried_across() -> None:
    async def scenario(link: StepperLink, peer: Controller) -> None:
        running = await link.start("MR 1000")
        peer.towards_host = lambda data: [data] if b"BOOT" in data else []
        asyncio.get_running_loop().call_later(0.1, peer.boot)
        with pytest.raises(PositionLost, match="restarted"):
            await link.request("Z 5")
        with pytest.raises(PositionLost, match="restarted"):
            running.end.result()
        await asyncio.sleep(2)

    peer = Controller()
    assert play(scenario, peer).counters.boots == 1
    assert peer.executed == ["MR 1000", "Z 5"]


def test_a_lost_port_fails_everybody_now_and_later() -> None:
    async def scenario(link: StepperLink, peer: Controller) -> None:
        running = await link.start("MR 1000")
        asyncio.get_running_loop().call_later(0.01, transport_of(peer).lose, OSError(5, "unplugged"))
        peer.deaf = True
        with pytest.raises(DeviceLost, match="unplugged"):
            await link.request("Q")
        with pytest.raises(DeviceLost):
            running.end.result()
        with pytest.raises(DeviceLost):
            await link.request("Q")

    play(scenario)


def test_a_write_after_the_transport_began_to_close_is_not_silently_dropped() -> None:
    async def scenario(link: StepperLink, peer: Controller) -> None:
        transport_of(peer).closing = True  # and connection_lost never comes
        with pytest.raises(DeviceLost):
            await link.request("Q")

    play(scenario)


def test_a_lost_done_is_learnt_by_asking() -> None:
    peer = Controller()
    peer.towards_host = lambda data: [] if b"DONE" in data else [data]

    async def scenario(link: StepperLink, peer: Controller) -> None:
        finished = await run_motion(link, "MA 100", 0.1, 2.0)
        assert finished.reached
        assert finished.position == 100

    assert play(scenario, peer).counters.done_by_poll == 1


def test_a_lost_fail_is_not_taken_for_success() -> None:
    peer = Controller(home_found=False)
    peer.towards_host = lambda data: [] if b"FAIL" in data else [data]

    async def scenario(link: StepperLink, peer: Controller) -> None:
        assert not (await run_motion(link, "H -1 100", 0.1, 2.0)).reached

    play(scenario, peer)


def test_a_motion_without_end_is_stopped_at_its_deadline() -> None:
    async def scenario(link: StepperLink, peer: Controller) -> None:
        with pytest.raises(DeviceTimeout, match=r"waited 2.5 s: the motion does not end; it was stopped"):
            await run_motion(link, "MA 100", 0.5, 2.0)

    peer = Controller(never_ends=True)
    play(scenario, peer)
    assert peer.executed[-1] == "S"


def test_halt_falls_back_to_stopping_without_ramp() -> None:
    async def scenario(link: StepperLink, peer: Controller) -> None:
        await link.start("MA 100")
        status, abrupt = await halt(link, 0.5)
        assert abrupt
        assert status.mode == 0

    peer = Controller(never_ends=True)
    play(scenario, peer)
    assert "X" in peer.executed


def test_requests_of_several_tasks_go_over_the_wire_one_at_a_time() -> None:
    peer = Controller()
    waiting = 0

    def watch(data: bytes) -> list[bytes]:
        nonlocal waiting
        waiting += 1
        assert waiting == 1
        return [data]

    def answered(data: bytes) -> list[bytes]:
        nonlocal waiting
        waiting -= 1
        return [data]

    peer.towards_firmware, peer.towards_host = watch, answered

    async def scenario(link: StepperLink, peer: Controller) -> None:
        async with asyncio.TaskGroup() as group:
            for _ in range(20):
                group.create_task(link.request("Q"))

    play(scenario, peer)
    assert len(peer.executed) == 20


def test_a_cancelled_request_leaves_the_line_usable() -> None:
    async def scenario(link: StepperLink, peer: Controller) -> None:
        task = asyncio.create_task(link.request("MR 5"))
        await asyncio.sleep(0.0015)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        assert await link.request("V 100") == ("100",)

    assert play(scenario).counters.stale == 1


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32), loss=st.floats(0, 0.4), flips=st.floats(0, 0.3))
def test_relative_moves_are_executed_exactly_once_whatever_the_noise(seed: int, loss: float, flips: float) -> None:
    noise = random.Random(seed)

    def damage(data: bytes) -> list[bytes]:
        if noise.random() < loss:
            return []
        if noise.random() < flips:
            broken = bytearray(data)
            broken[noise.randrange(len(broken))] ^= 1 << noise.randrange(8)
            return [bytes(broken)]
        return [data[:3], data[3:]]

    async def scenario(link: StepperLink, peer: Controller) -> None:
        for _ in range(10):
            assert (await run_motion(link, "MR 3", 0.003, 60.0)).reached
            assert (await run_motion(link, "MR -1", 0.001, 60.0)).reached

    peer = Controller(towards_host=damage, towards_firmware=damage)
    play(scenario, peer, attempts=60)
    assert peer.position == 20


def test_first_sequence_number_is_random() -> None:
    assert len({StepperLink("mem")._seq for _ in range(20)}) > 10


def test_line_helper_matches_the_protocol() -> None:
    assert line("<", "7 OK 8") == b"<7 OK 8*09EA\n"
