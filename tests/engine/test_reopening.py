"""A device that is opened anew between scans: the one that went, at rest, and within its time; or an error that says what to do."""

import asyncio
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from scanhsi.clock import now_ns, run_virtual
from scanhsi.devices import Actuator, Camera, Light, LightInfo, Lit, Range
from scanhsi.devices.errors import (
    DeviceError,
    DeviceLost,
    DeviceNotFound,
    DeviceTimeout,
    DeviceUnsafe,
    PositionLost,
    ScanFailed,
    UnsupportedFeature,
)
from scanhsi.engine.deadlines import CLOSE_S, CONNECT_S, STOP_S
from scanhsi.engine.lost import LostDevices
from scanhsi.engine.reopening import DeviceRole, reopen
from scanhsi.instrument import Instrument, load_instrument
from support.bench import Bench, BenchActuator, BenchCamera


class BenchLight:
    def __init__(self) -> None:
        self.info = LightInfo("light bench", "bench", "1", Range(1, 1), simulated=True)
        self.level = 1.0

    async def connect(self) -> None: ...

    async def close(self) -> None: ...

    async def on(self, level: float | None = None) -> Lit:
        raise AssertionError("opened anew, nothing is switched on")

    async def off(self) -> None:
        self.level = 0.0


def bench(
    camera: Camera | None = None, actuator: Actuator | None = None, light: Light | None = None
) -> tuple[Instrument, list[str]]:
    """An instrument on the bench, and what is asked of its devices."""
    asked: list[str] = []
    true = Bench()
    camera, actuator = camera or BenchCamera(true), actuator or BenchActuator(true)
    config = load_instrument("sensors2019")
    instrument = Instrument(config, camera, actuator, camera.info, actuator.info, light, light.info if light else None)
    for role, device in (("camera", camera), ("actuator", actuator), ("light", light)):
        for name in ("connect", "close", "stop", "off", "home", "move_to", "configure"):
            if hasattr(device, name):
                _listen(device, name, lambda call=f"{role} {name}": asked.append(call))
    return instrument, asked


def _listen(device: Any, name: str, tell: Callable[[], None]) -> None:
    method = getattr(device, name)

    async def listened(*arguments: Any) -> Any:
        tell()
        return await method(*arguments)

    setattr(device, name, listened)


async def stuck(self: object) -> None:
    del self
    await asyncio.Event().wait()


@pytest.mark.parametrize(
    ("role", "asked"),
    [
        ("camera", ["camera close", "camera connect"]),
        ("actuator", ["actuator close", "actuator stop", "actuator connect", "actuator stop"]),
        ("light", ["light close", "light connect", "light off"]),
    ],
)
def test_it_is_closed_and_connected_and_at_rest_and_nothing_moves(role: DeviceRole, asked: list[str]) -> None:
    light = BenchLight()
    instrument, done = bench(light=light)
    run_virtual(reopen(instrument, role))
    assert done == asked
    assert light.level == (0 if role == "light" else 1)


def test_one_that_does_not_close_is_opened_all_the_same() -> None:
    class Stuck(BenchCamera):
        close = stuck

    instrument, asked = bench(Stuck(Bench()))
    run_virtual(reopen(instrument, "camera"))
    assert asked == ["camera close", "camera connect"]


def test_one_that_does_not_open_is_given_up_in_time() -> None:
    class Stuck(BenchCamera):
        close = stuck
        connect = stuck

    instrument, asked = bench(Stuck(Bench()))

    async def main() -> float:
        with pytest.raises(DeviceTimeout, match="camera bench, connect, waited 30 s: .* Try: power and cable"):
            await reopen(instrument, "camera")
        return now_ns() * 1e-9

    assert run_virtual(main()) == pytest.approx(CONNECT_S + 2 * CLOSE_S)
    assert asked[-1] == "camera close"


def test_a_mirror_that_does_not_confirm_that_it_stands_is_unsafe_and_stays_closed() -> None:
    class Running(BenchActuator):
        stop = stuck

        async def close(self) -> None: ...

    instrument, asked = bench(actuator=Running(Bench()))

    async def main() -> float:
        with pytest.raises(DeviceUnsafe, match="UNSAFE, the mirror may be moving"):
            await reopen(instrument, "actuator")
        return now_ns() * 1e-9

    assert run_virtual(main()) == pytest.approx(STOP_S)
    assert asked == ["actuator close", "actuator connect", "actuator stop", "actuator close"]


@pytest.mark.parametrize("other", [{"serial": "2"}, {"firmware": "2"}, {"vendor": "other"}])
def test_another_camera_is_not_worked_with(other: dict[str, str]) -> None:
    class Swapped(BenchCamera):
        async def connect(self) -> None:
            self.info = replace(self.info, **other)

    instrument, asked = bench(Swapped(Bench()))
    with pytest.raises(DeviceNotFound, match="another device answers there.*restart the service"):
        run_virtual(reopen(instrument, "camera"))
    assert asked[-1] == "camera close"


@pytest.mark.parametrize("finds_home", [True, False])
@pytest.mark.parametrize("now", [(7, True), (0, True), (7, False)])
def test_a_position_that_nobody_knows_any_more_is_told(finds_home: bool, now: tuple[int, bool]) -> None:
    class Restarted(BenchActuator):
        def __init__(self, bench: Bench) -> None:
            super().__init__(bench)
            self.info = replace(self.info, finds_home=finds_home)

        async def connect(self) -> None:
            self.bench.position, self.bench.homed = now

    true = Bench()
    instrument, asked = bench(actuator=Restarted(true))
    lost = LostDevices(instrument)
    if finds_home or now == (7, True):
        run_virtual(lost.reopen(["actuator"]))
    else:
        with pytest.raises(PositionLost, match="cannot find its home by itself.*set the mirror by hand"):
            run_virtual(lost.reopen(["actuator"]))
    assert lost.why == {}, "it is open"
    assert asked[-1] == "actuator stop"


def test_there_may_be_no_light() -> None:
    lost = LostDevices(bench()[0])
    with pytest.raises(UnsupportedFeature, match="it has no light"):
        run_virtual(lost.reopen(["light"]))
    assert lost.why == {}


def test_which_are_lost() -> None:
    lost = LostDevices(bench(light=BenchLight())[0])
    lost.note(DeviceTimeout("slow.", device="camera bench"))
    lost.note(DeviceLost("whose?"))
    assert lost.why == {}
    lost.note(DeviceLost("gone.", device="light bench"))
    lost.note(ScanFailed([DeviceError("x")], stored=0, lines=1, lost={"camera": "silent."}))
    assert lost.why == {"camera": "silent.", "light": "light bench: gone."}


def test_all_that_are_lost_are_tried_and_all_failures_told() -> None:
    class Away(BenchCamera):
        async def connect(self) -> None:
            raise DeviceNotFound("nothing answers.", device=self.info.name)

    class AwayToo(BenchActuator):
        async def connect(self) -> None:
            raise DeviceNotFound("no such port.", device=self.info.name)

    light = BenchLight()
    true = Bench()
    lost = LostDevices(bench(Away(true), AwayToo(true), light)[0])
    lost.note(
        ScanFailed([DeviceError("x")], stored=0, lines=1, lost=dict.fromkeys(("camera", "actuator", "light"), "x"))
    )
    with pytest.raises(
        DeviceError, match=r"(?s)2 devices.*camera bench: nothing answers.*actuator bench: no such port"
    ):
        run_virtual(lost.reopen())
    assert lost.why.keys() == {"camera", "actuator"}
    assert light.level == 0


def test_cancelled_half_way_it_counts_as_lost() -> None:
    class Slow(BenchCamera):
        async def connect(self) -> None:
            await asyncio.sleep(20)

    lost = LostDevices(bench(Slow(Bench()))[0])

    async def main() -> None:
        task = asyncio.ensure_future(lost.reopen(["camera"]))
        await asyncio.sleep(10)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        assert lost.why.keys() == {"camera"}
        await lost.reopen()
        assert lost.why == {}

    run_virtual(main())
