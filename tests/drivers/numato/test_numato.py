"""The light on a relay: the suite for drivers, and what goes wrong."""

import asyncio
import random
from collections.abc import Awaitable, Callable, Iterator
from typing import Any

import pytest

from scanhsi.clock import run
from scanhsi.devices.errors import DeviceError, DeviceLost, DeviceNotFound, DeviceTimeout, ProtocolError
from scanhsi.testing.conformance import LightConformance
from scanhsi_numato import NumatoLight, NumatoOptions
from support.relay_module import RelayModule

Scenario = Callable[[NumatoLight], Awaitable[None]]


@pytest.fixture
def module() -> Iterator[RelayModule]:
    running = RelayModule()
    yield running
    running.close()


class TestNumato(LightConformance):
    @pytest.fixture(autouse=True)
    def _on_a_pty(self, module: RelayModule) -> None:
        self.port = module.port

    def make(self) -> NumatoLight:
        return NumatoLight(NumatoOptions(port=self.port, warm_up_s=0.5))


def with_light(module: RelayModule, scenario: Scenario, **options: Any) -> None:
    async def main() -> None:
        light = NumatoLight(NumatoOptions(port=module.port, **{"reply_timeout_s": 0.1, **options}))
        try:
            await light.connect()
            await scenario(light)
        finally:
            await light.close()

    run(main())


def test_it_switches_its_relay_and_no_other(module: RelayModule) -> None:
    module.relays[3] = True

    async def scenario(light: NumatoLight) -> None:
        await light.on()
        assert [number for number, on in enumerate(module.relays) if on] == [3, 11]

    with_light(module, scenario, relay=11)
    assert [number for number, on in enumerate(module.relays) if on] == [3]
    assert "relay on B" in module.commands


def test_a_light_on_the_other_contact(module: RelayModule) -> None:
    module.relays[0] = True

    async def scenario(light: NumatoLight) -> None:
        assert light.level == 0
        await light.on()
        assert not module.relays[0]

    with_light(module, scenario, normally_closed=True)
    assert module.relays[0]


def test_a_light_that_a_dead_program_left_on_is_seen_and_closed_off(module: RelayModule) -> None:
    module.relays[0] = True

    async def scenario(light: NumatoLight) -> None:
        assert light.level == 1

    with_light(module, scenario)
    assert not module.relays[0]


def test_a_relay_that_sticks_is_told(module: RelayModule) -> None:
    async def scenario(light: NumatoLight) -> None:
        await light.on()
        module.stuck.add(0)
        with pytest.raises(DeviceError, match="stays on"):
            await light.off()
        assert light.level == 1

    with pytest.raises(DeviceError, match="stays on"):  # by close, too
        with_light(module, scenario)


def test_a_module_that_does_not_answer_is_not_known_to_be_off(module: RelayModule) -> None:
    async def scenario(light: NumatoLight) -> None:
        await light.on()
        module.deaf = True
        with pytest.raises(DeviceTimeout):
            await light.off()
        with pytest.raises(DeviceError, match="not known"):
            _ = light.level
        module.deaf = False
        await light.off()
        assert light.level == 0

    with_light(module, scenario, reply_timeout_s=0.03)


def test_noise_on_the_line_costs_time_and_tells_no_lies(module: RelayModule) -> None:
    chance = random.Random(7)

    def damage(byte: bytes) -> bytes:
        if chance.random() < 0.01:
            return b""
        return bytes([byte[0] ^ 1 << chance.randrange(7)]) if chance.random() < 0.01 else byte

    async def scenario(light: NumatoLight) -> None:
        module.damage = damage
        for index in range(40):
            await (light.off() if index % 2 else light.on())
            assert module.relays[0] == (index % 2 == 0) == bool(light.level)
        module.damage = lambda byte: byte

    with_light(module, scenario, reply_timeout_s=0.02, reply_attempts=20)


def test_unplugged(module: RelayModule) -> None:
    async def scenario(light: NumatoLight) -> None:
        await light.on()
        module.unplug()
        with pytest.raises(DeviceLost):
            async with asyncio.timeout(20):
                await light.off()

    with_light(module, scenario)


def test_nothing_of_the_kind_at_the_port(module: RelayModule) -> None:
    module.deaf = True

    async def scenario(light: NumatoLight) -> None:
        raise AssertionError("connected to nothing")

    with pytest.raises(DeviceNotFound, match="relay module"):
        with_light(module, scenario, reply_timeout_s=0.02)


def test_a_relay_that_the_module_lacks(module: RelayModule) -> None:
    async def scenario(light: NumatoLight) -> None:
        raise AssertionError("there is no relay 31")

    with pytest.raises(ProtocolError, match="that many relays"):
        with_light(module, scenario, relay=31)
