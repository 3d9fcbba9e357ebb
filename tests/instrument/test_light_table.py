"""The ``[light]`` table of an instrument file, and the light of an open instrument."""

from pathlib import Path

import pytest

from scanhsi import clock
from scanhsi.devices.errors import ConfigError, DeviceError
from scanhsi.instrument import Instrument, InstrumentConfig, load_instrument
from scanhsi.instrument.schema import schema

LIGHT = {"light.driver": "simulated", "light.bench": "lamp table", "camera.bench": "lamp table"}


def test_an_instrument_without_a_light_has_none() -> None:
    async def main() -> None:
        async with Instrument.open(load_instrument("sensors2019")) as instrument:
            assert instrument.light is None
            assert "light" not in instrument.describe()

    clock.run(main(), virtual=True)


def test_the_light_is_opened_described_and_off_in_the_end() -> None:
    config = load_instrument("sensors2019", {**LIGHT, "light.warm_up_s": 5.0})
    assert config.virtual_time

    async def main() -> None:
        async with Instrument.open(config) as instrument:
            light = instrument.light
            assert light is not None
            assert light.level == 0
            assert instrument.describe()["light"]["driver"] == "simulated"
            assert instrument.describe()["light"]["warm_up_s"] == 5
            assert instrument.simulated
            await light.on()
        with pytest.raises(DeviceError, match="not connected"):
            _ = light.level

    clock.run(main(), virtual=True)


def test_a_real_light_keeps_an_instrument_in_real_time() -> None:
    assert not load_instrument("sensors2019", {"light.driver": "numato", "light.port": "/dev/null"}).virtual_time


def test_a_light_that_does_not_connect_closes_the_others(tmp_path: Path) -> None:
    config = load_instrument("sensors2019", {"light.driver": "numato", "light.port": str(tmp_path / "none")})

    async def main() -> None:
        for _ in range(2):  # the second time nothing of the first is in the way
            with pytest.raises(DeviceError, match="light numato .*no such port"):
                async with Instrument.open(config):
                    raise AssertionError("opened without its light")

    clock.run(main())


def test_what_is_wrong_in_the_table_is_told() -> None:
    with pytest.raises(ConfigError, match=r"light\.wattage = 20: there is no such key; .*warm_up_s"):
        load_instrument("sensors2019", {**LIGHT, "light.wattage": 20})
    with pytest.raises(ConfigError, match=r"light\.driver = \"candle\": there is no light driver"):
        load_instrument("sensors2019", {"light.driver": "candle"})


def test_the_schema_knows_the_lights() -> None:
    tables = schema()["$defs"]["LightConfig"]["oneOf"]
    assert {table["title"] for table in tables} >= {'driver = "numato"', 'driver = "simulated"'}
    assert "light" not in schema()["required"]
    assert InstrumentConfig.model_fields["light"].default is None
