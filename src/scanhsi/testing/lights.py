"""The light contract as tests; see `scanhsi.devices.light`."""

from __future__ import annotations

import asyncio
from contextlib import suppress

import pytest

from scanhsi.clock import now_ns
from scanhsi.devices import Light
from scanhsi.devices.errors import DeviceBusy, DeviceError, OutOfRange
from scanhsi.testing.devices import DeviceConformance, cancelled_after, refused


class LightConformance(DeviceConformance[Light]):
    """Inherit, write ``make``, and every test below runs on your light. It has to be off when a test begins."""

    def test_info(self) -> None:
        """After ``connect`` the info is whole."""

        async def use(light: Light) -> None:
            info = light.info
            assert info.name
            assert 0 < info.levels.minimum <= info.levels.maximum <= 1
            assert info.warm_up_s >= 0

        self.run(use)

    def test_connect_switches_nothing(self) -> None:
        """It is as it was: off."""

        async def use(light: Light) -> None:
            assert light.level == 0

        self.run(use)

    def test_on_and_off(self) -> None:
        """Each returns when it is so; stamps in order; the warm-up counts from when it was switched on."""

        async def use(light: Light) -> None:
            before = now_ns()
            lit = await light.on()
            assert light.level == lit.level > 0
            assert before <= lit.commanded_ns <= lit.lit_ns <= now_ns() + 1
            assert lit.steady_ns - lit.lit_ns == round(light.info.warm_up_s * 1e9)
            again = await light.on()
            assert (again.lit_ns, again.steady_ns) == (lit.lit_ns, lit.steady_ns)
            await light.off()
            assert light.level == 0
            assert (await light.on()).lit_ns >= again.commanded_ns

        self.run(use)

    def test_every_level(self) -> None:
        """The highest and the lowest level are as asked for."""

        async def use(light: Light) -> None:
            for level in (light.info.levels.maximum, light.info.levels.minimum):
                assert (await light.on(level)).level == pytest.approx(level, abs=0.01)
                assert light.level == pytest.approx(level, abs=0.01)

        self.run(use)

    def test_levels_that_are_not_allowed_switch_nothing(self) -> None:
        """`OutOfRange`, and it stays off."""

        async def use(light: Light) -> None:
            levels = light.info.levels
            for level in (levels.maximum + 0.1, levels.minimum / 2, 0.0, -1.0):
                await refused(f"on({level})", (OutOfRange,), light.on(level))
                assert light.level == 0

        self.run(use)

    def test_off_again_and_again(self) -> None:
        """``off`` of what is off, and after it was on."""

        async def use(light: Light) -> None:
            for _ in range(3):
                await light.off()
            await light.on()
            for _ in range(3):
                await light.off()
                assert light.level == 0

        self.run(use)

    @pytest.mark.parametrize("cancelled", [False, True])
    @pytest.mark.parametrize("share", [0.0, 0.3, 0.8])
    def test_off_beside_on(self, share: float, cancelled: bool) -> None:
        """``off`` beside a running ``on``, and after a cancelled one: the light is off then, and stays so."""

        async def use(light: Light) -> None:
            before = now_ns()
            await light.on()
            takes_s = (now_ns() - before) * 1e-9
            await light.off()
            switching = asyncio.ensure_future(light.on())
            await asyncio.sleep(share * takes_s)
            if cancelled:
                switching.cancel()
            await light.off()
            with suppress(DeviceError, asyncio.CancelledError):
                await switching
            await asyncio.sleep(2 * takes_s)
            assert light.level == 0
            await light.on()
            assert light.level > 0

        self.run(use)

    @pytest.mark.parametrize("rounds", [0, 1, 3])
    @pytest.mark.parametrize("method", ["connect", "off", "close"])
    def test_any_method_may_be_cancelled(self, method: str, rounds: int) -> None:
        """Cancelled after some rounds of the loop: ``close`` works, then it can be opened anew, and is off."""

        async def use(light: Light) -> None:
            if method != "connect":
                await light.connect()
                await light.on()
            call = {"connect": light.connect, "off": light.off, "close": light.close}[method]
            await cancelled_after(rounds, call())
            await light.close()
            await light.connect()
            assert light.level == 0
            await light.on()
            await light.off()

        self.run(use, connected=False)

    def test_close_switches_off(self) -> None:
        """Whoever connects next finds it off."""

        async def leave_on(light: Light) -> None:
            await light.on()

        async def use(light: Light) -> None:
            assert light.level == 0

        self.run(leave_on)
        self.run(use)

    def test_close_is_idempotent_and_may_come_at_any_time(self) -> None:
        """``close`` and ``off`` in any state, and ``connect`` after it."""

        async def use(light: Light) -> None:
            await light.close()
            await light.connect()
            await light.off()
            await light.close()
            await light.close()
            await light.connect()
            await light.on()

        self.run(use, connected=False)

    def test_a_second_user_is_refused(self) -> None:
        """`DeviceBusy` for whoever comes second; the first is not disturbed."""
        if not self.exclusive:
            pytest.skip("the device may be shared (exclusive = False)")

        async def use(light: Light) -> None:
            await light.on()
            second = self.make()
            try:
                await refused("connecting a second object", (DeviceBusy,), second.connect())
            finally:
                await second.close()
            assert light.level > 0

        self.run(use)

    def test_out_of_order_calls_are_errors_of_the_tree(self) -> None:
        """Switching what is not connected: a `DeviceError`, and no hang."""

        async def use(light: Light) -> None:
            await refused("on() before connect()", (DeviceError,), light.on())
            await light.connect()
            await light.on()

        self.run(use, connected=False)
