"""Lights that break one promise each: the suite must say so, in the test that is about it."""

import asyncio
from dataclasses import replace

import pytest

from scanhsi.devices import Role, find
from scanhsi.devices.errors import DeviceError
from scanhsi.testing.conformance import LightConformance
from scanhsi.testing.devices import _used

LIGHT = find(Role.LIGHT, "simulated")
GoodLight = LIGHT.device


class SwitchesOnWithConnect(GoodLight):
    async def connect(self):
        await super().connect()
        await super().on()


class TakesAnyLevel(GoodLight):
    async def on(self, level=None):
        return await super().on()


class GoesOnAfterOff(GoodLight):
    async def on(self, level=None):
        await asyncio.sleep(0.02)
        return await super().on(level)


class StaysOnWhenClosed(GoodLight):
    async def close(self):
        lit = bool(self._bench.lit) and self.level
        await super().close()
        if lit:
            self._bench.lit = [(0, True)]
            type(self).kept = self._bench  # which would be a new one else


class WarmsUpAnew(GoodLight):
    async def on(self, level=None):
        lit = await super().on(level)
        return replace(lit, lit_ns=lit.commanded_ns, steady_ns=lit.commanded_ns)


class OffOnlyWhenOn(GoodLight):
    async def off(self):
        if not self.level:
            raise DeviceError("it is off already.")
        await super().off()


BAD_LIGHTS = [
    (SwitchesOnWithConnect, "test_connect_switches_nothing", ()),
    (TakesAnyLevel, "test_levels_that_are_not_allowed_switch_nothing", ()),
    (GoesOnAfterOff, "test_off_beside_on", (0.3, False)),
    (StaysOnWhenClosed, "test_close_switches_off", ()),
    (WarmsUpAnew, "test_on_and_off", ()),
    (OffOnlyWhenOn, "test_off_again_and_again", ()),
]


@pytest.mark.parametrize(("bad", "test", "arguments"), BAD_LIGHTS, ids=lambda value: getattr(value, "__name__", None))
def test_bad_lights_are_caught(bad, test, arguments):
    def suite(kind):
        class Suite(LightConformance):
            virtual = True

            def make(self):
                return kind(LIGHT.options(bench=f"bad light {bad.__name__}", warm_up_s=1.0))

        _used.add(Suite)  # what is left behind counts from the first use
        return getattr(Suite(), test)

    suite(GoodLight)(*arguments)  # the test itself is satisfied by a good one
    with pytest.raises((AssertionError, DeviceError, ExceptionGroup, pytest.fail.Exception)):
        suite(bad)(*arguments)
