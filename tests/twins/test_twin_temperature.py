"""`MeasuresTemperature` of both camera drivers, on twins that tell their temperature and that do not."""

import asyncio
import re
from collections.abc import AsyncGenerator, Iterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from structlog.testing import capture_logs

from scanhsi.clock import run
from scanhsi.devices import CameraSettings, Frame, PixelFormat, Roi, Trigger
from scanhsi.devices.errors import DeviceError
from scanhsi_aravis import AravisCamera, AravisOptions
from scanhsi_aravis import features as aravis_features
from scanhsi_genicam import GenicamCamera, GenicamOptions
from scanhsi_genicam import features as genicam_features
from scanhsi_sim.twins.camera import GENICAM
from support import twins

pytestmark = pytest.mark.twin

SMALL = CameraSettings(0.002, 0.0, PixelFormat.MONO8, Roi(64, 32, 256, 64))
CAMERAS = {
    "aravis": lambda: AravisCamera(AravisOptions(address="127.0.0.1")),
    "genicam": lambda: GenicamCamera(GenicamOptions(address="127.0.0.1", interface="lo", discovery_s=0.1)),
}
each_driver = pytest.mark.parametrize("driver", CAMERAS)


NODE = re.compile(r'<Converter Name="DeviceTemperature".*?</Converter>', re.DOTALL)
REGISTER = re.compile(r'(Name="DeviceTemperatureReg".*?)NoCache', re.DOTALL)


def described(folder: Path, pattern: re.Pattern[str], replacement: str) -> Path:
    """The Mako's description with one change."""
    text, changes = pattern.subn(replacement, GENICAM.read_text())
    assert changes == 1
    path = folder / "changed.xml"
    path.write_text(text)
    return path


KINDS = {
    "warm": (REGISTER, r"\1WriteThrough"),  # says that it may be cached, and changes all the same
    "without": (NODE, ""),
}
warm, without = (pytest.mark.parametrize("twin", [kind], indirect=True) for kind in KINDS)


@pytest.fixture(scope="module")
def twin(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[twins.Running]:
    """A twin with one of the descriptions."""
    with twins.running(genicam=described(tmp_path_factory.mktemp("twin"), *KINDS[request.param])) as running:
        yield running


@asynccontextmanager
async def connected(driver: str) -> AsyncGenerator[AravisCamera | GenicamCamera]:
    camera = CAMERAS[driver]()
    await camera.connect()
    try:
        yield camera
    finally:
        await camera.close()


@warm
@each_driver
def test_told_as_it_is_now(twin: twins.Running, driver: str) -> None:
    async def main() -> None:
        async with connected(driver) as camera:
            for milli in (43_000, 43_125, -5_500):
                assert await asyncio.to_thread(twin.command, f"temperature {milli}") == "ok"
                assert await camera.temperature_c() == pytest.approx(milli / 1000)

    run(main())


@warm
@each_driver
def test_told_while_armed_without_a_frame_lost(twin: twins.Running, driver: str) -> None:
    """Asked all the time, from arming to the last frame."""
    twin.command("temperature 40000")
    before = twin.stats()["exposures"]

    async def main() -> None:
        async with connected(driver) as camera:
            await camera.configure(SMALL)
            await camera.arm(Trigger.SOFTWARE, 4)
            told: list[float | None] = []

            async def ask() -> None:
                while True:
                    told.append(await camera.temperature_c())

            asking = asyncio.create_task(ask())
            for index in range(10):
                exposure = await camera.expose()
                frame = await anext(camera.frames())
                assert isinstance(frame, Frame)
                assert (exposure.index, frame.index) == (index, index)
            asking.cancel()
            await asyncio.wait([asking])
            assert set(told) == {40.0}

    run(main())
    assert twin.stats()["exposures"] == before + 10


@each_driver
def test_not_connected(driver: str) -> None:
    async def main() -> None:
        with pytest.raises(DeviceError, match="not connected"):
            await CAMERAS[driver]().temperature_c()

    run(main())


async def not_known(driver: str) -> None:
    """None, before and while armed, and frames come."""
    async with connected(driver) as camera:
        assert await camera.temperature_c() is None
        await camera.configure(SMALL)
        await camera.arm(Trigger.SOFTWARE, 4)
        assert await camera.temperature_c() is None
        await camera.expose()
        assert isinstance(await anext(camera.frames()), Frame)


@warm
@each_driver
def test_unreadable(twin: twins.Running, driver: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is there, and no number: so is the model's name."""
    for features in (aravis_features, genicam_features):
        monkeypatch.setattr(features, "TEMPERATURE", "DeviceModelName")
    with capture_logs() as logs:
        run(not_known(driver))
    assert [entry["event"] for entry in logs].count("the camera's temperature cannot be read") == 2


@without
@each_driver
def test_not_told(twin: twins.Running, driver: str) -> None:
    with capture_logs() as logs:
        run(not_known(driver))
    assert not [entry for entry in logs if "temperature" in entry["event"]]
