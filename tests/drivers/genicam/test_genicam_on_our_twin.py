"""The GenICam driver on the twin of a Mako, another GigE Vision camera by another hand: other feature names, 12-bit formats."""

from collections.abc import Iterator

import numpy as np
import pytest

from scanhsi.clock import run
from scanhsi.devices import CameraSettings, Frame, PixelFormat, Roi, Trigger
from scanhsi.testing.conformance import CameraConformance
from scanhsi_genicam import GenicamCamera, GenicamOptions
from scanhsi_sim.scenes.testpattern import decode
from support import twins

pytestmark = pytest.mark.twin


class OnTheTwin(CameraConformance):
    exposure_s = 0.005
    shape = (64, 256)
    loses_frames = True

    def make(self) -> GenicamCamera:
        return GenicamCamera(GenicamOptions(address="127.0.0.1", interface="lo", discovery_s=0.1))


@pytest.fixture(scope="module", autouse=True)
def _twin() -> Iterator[None]:
    with twins.running(scene="testpattern", step=137):
        yield


@pytest.mark.parametrize(
    "name",
    [
        "test_configure_tells_what_was_applied",
        "test_each_exposure_is_one_frame_or_in_one_gap_in_order",
        "test_pixels_of_every_format",
    ],
)
def test_promise(name: str) -> None:
    getattr(OnTheTwin(), name)()


def test_what_it_is_and_what_it_sees() -> None:
    async def main() -> None:
        camera = OnTheTwin().make()
        await camera.connect()
        try:
            info = camera.info
            assert (info.bands, info.samples) == (1088, 2048)
            assert {PixelFormat.MONO8, PixelFormat.MONO12, PixelFormat.MONO12_PACKED} <= set(info.pixel_formats)
            assert info.readout_s == pytest.approx(1 / 49.5, rel=0.01)
            await camera.configure(CameraSettings(0.01, 0.0, PixelFormat.MONO12_PACKED, Roi(800, 400, 96, 48)))
            await camera.arm(Trigger.SOFTWARE, 4)
            await camera.expose()
            frame = await anext(camera.frames())
            assert isinstance(frame, Frame)
            pixels = np.zeros(frame.shape, np.uint16)
            await camera.unpack(frame, pixels)
            assert decode(pixels, offset=(400, 800)).step == 137
        finally:
            await camera.close()

    run(main())
