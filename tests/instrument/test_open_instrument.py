"""The open instrument: both devices or none, and always closed."""

import asyncio
from pathlib import Path

import pytest

from scanhsi.clock import run_virtual
from scanhsi.devices import CameraSettings, PixelFormat, Roi
from scanhsi.devices.errors import (
    ConfigError,
    DeviceError,
    DeviceLost,
    DeviceNotFound,
    DeviceTimeout,
    DeviceUnavailable,
    OutOfRange,
)
from scanhsi.instrument import Instrument, InstrumentConfig, load_instrument
from support.spare_drivers import JOURNAL, Spare

pytestmark = pytest.mark.usefixtures("spares")


def config(camera: str = "", actuator: str = "", **tables: object) -> InstrumentConfig:
    return InstrumentConfig.model_validate(
        {
            "name": "lab",
            "camera": {"driver": "spare", "fault": camera},
            "actuator": {"driver": "spare", "fault": actuator},
            "geometry": {"distance": "0.3 m", "normal_step": 0},
            **tables,
        }
    )


async def visit(instrument: InstrumentConfig) -> float:
    """Open and close; the time that opening took."""
    start = asyncio.get_running_loop().time()
    async with Instrument.open(instrument):
        assert len(Spare.opened) == 2
        return asyncio.get_running_loop().time() - start


def test_devices_connect_at_once_and_close_in_reverse() -> None:
    assert run_virtual(visit(config())) == pytest.approx(0.1)
    assert sorted(JOURNAL[:2]) == ["connect actuator", "connect camera"]
    assert JOURNAL[2:] == ["close actuator", "close camera"]


def test_the_working_device_is_closed_when_the_other_fails() -> None:
    with pytest.raises(DeviceNotFound, match="nothing answers at here"):
        run_virtual(visit(config(camera="connect")))
    assert JOURNAL[2:] == ["close actuator", "close camera"]
    assert not Spare.opened


def test_every_failure_is_told() -> None:
    with pytest.raises(DeviceError, match="2 devices did not connect") as caught:
        run_virtual(visit(config(camera="connect", actuator="crash")))
    assert "camera spare, connect: nothing answers" in str(caught.value)
    assert "ZeroDivisionError: a bug in a driver" in str(caught.value)
    assert isinstance(caught.value.__cause__, ExceptionGroup)


def test_a_connect_that_hangs_has_a_deadline() -> None:
    with pytest.raises(DeviceTimeout, match=r"actuator spare, connect, waited 30 s"):
        run_virtual(visit(config(actuator="hang")))
    assert not Spare.opened


def test_a_failing_close_is_told_and_the_other_device_closed() -> None:
    with pytest.raises(DeviceLost, match="did not say goodbye"):
        run_virtual(visit(config(actuator="close")))
    assert JOURNAL[2:] == ["close actuator", "close camera"]
    with pytest.raises(DeviceError, match="2 devices did not close"):
        run_virtual(visit(config(camera="close", actuator="close")))


def test_a_failing_close_does_not_hide_what_went_wrong() -> None:
    async def fail() -> None:
        async with Instrument.open(config(camera="close")):
            raise KeyError("the real cause")

    with pytest.raises(KeyError, match="the real cause") as caught:
        run_virtual(fail())
    assert any("did not say goodbye" in note for note in caught.value.__notes__)


@pytest.mark.parametrize("cancel_after_s", [0.05, 0.15, 0.25, 0.35])
def test_cancelled_at_any_stage_nothing_stays_open(cancel_after_s: float) -> None:
    async def stay() -> None:
        async with Instrument.open(config()):
            await asyncio.sleep(0.1)

    async def main() -> None:
        task = asyncio.create_task(stay())
        await asyncio.sleep(cancel_after_s)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task

    run_virtual(main())
    assert JOURNAL.count("close camera") == JOURNAL.count("close actuator") == 1
    assert not Spare.opened


def test_limits_narrow_what_devices_allow() -> None:
    async def main() -> None:
        limits = {"exposure": ["10 ms", "2 s"], "gain": ["0 dB", "12 dB"], "steps": [-1200, 1200]}
        async with Instrument.open(config(limits=limits)) as instrument:
            assert instrument.camera_info.exposure.minimum == pytest.approx(0.01)
            settings = CameraSettings(0.02, 3.0, PixelFormat.MONO8)
            assert instrument.check(settings, (-1200, 1200)).roi == Roi(0, 0, 128, 64)
            with pytest.raises(OutOfRange, match=r"position 1201 steps is not allowed; allowed is -1200 to 1200 steps"):
                instrument.check(settings, (0, 1201))
            with pytest.raises(OutOfRange, match=r"exposure 0.005 s is not allowed; allowed is 0.01 to 2 s"):
                instrument.check(CameraSettings(0.005, 0.0, PixelFormat.MONO8), ())

    run_virtual(main())


def test_a_file_that_does_not_fit_its_devices() -> None:
    wrong = config(
        geometry={"distance": "0.3 m", "normal_step": 0, "steps_per_revolution": 3200},
        limits={"exposure": ["1 us", "1 s"], "steps": [0, 9999]},
        roi={"samples": 100, "bands": 100, "sample_offset": 100},
    )
    with pytest.raises(ConfigError, match="instrument lab does not fit its devices") as caught:
        run_virtual(visit(wrong))
    assert caught.value.problems == (
        "geometry.steps_per_revolution = 3200: actuator spare here has 19200",
        "roi: samples end at 200, the sensor of camera spare here has 128",
        "roi: bands end at 100, the sensor of camera spare here has 64",
        "limits.exposure = [1e-06, 1] s: camera spare here allows 2.1e-05 to 153 s in steps of 1e-06",
        "limits.steps = [0, 9999] steps: actuator spare here allows -2400 to 2400 steps in steps of 1",
    )
    assert not Spare.opened


def test_a_missing_library_is_told_before_anything_is_opened() -> None:
    wired = config().model_dump() | {"camera": {"driver": "wired", "address": "x"}}
    with pytest.raises(DeviceUnavailable, match=r"camera wired: libspare is missing; apt install libspare"):
        run_virtual(visit(InstrumentConfig.model_validate(wired)))
    assert not JOURNAL


def test_describe_is_json() -> None:
    async def main() -> dict[str, object]:
        async with Instrument.open(config()) as instrument:
            return instrument.describe()

    described = run_virtual(main())
    assert described["simulated"] is True
    assert described["camera"]["triggers"] == ["line", "software"]  # type: ignore[index]
    assert described["camera"]["exposure"] == {"minimum": 21e-6, "maximum": 153.0, "step": 1e-6, "unit": "s"}  # type: ignore[index]


def test_an_instrument_opens_from_its_file(tmp_path: Path) -> None:
    path = tmp_path / "lab.toml"
    path.write_text(
        '[camera]\ndriver = "spare"\n[actuator]\ndriver = "spare"\n[geometry]\ndistance = "0.3 m"\nnormal_step = 0\n'
    )
    run_virtual(visit(load_instrument(path)))
