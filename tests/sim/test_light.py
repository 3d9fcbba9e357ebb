"""The simulated light: the suite for drivers, and what the camera on its bench sees."""

import numpy as np
import pytest

from scanhsi import clock
from scanhsi.devices import CameraSettings, Frame, PixelFormat, Roi, Trigger
from scanhsi.testing.conformance import LightConformance
from scanhsi_sim import CameraOptions, LightOptions
from scanhsi_sim.camera import create_camera
from scanhsi_sim.light import SimulatedLight

ROI = Roi(0, 0, 16, 32)


class TestSimulatedLight(LightConformance):
    virtual = True

    def make(self) -> SimulatedLight:
        return SimulatedLight(LightOptions(bench="light", warm_up_s=60))


def seen(level_by_frame: list[bool] | None, **lamp: float) -> list[float]:
    """Mean pixel of one frame after the other, the light switched before each; None: there is no light to be switched."""

    async def main() -> list[float]:
        camera = create_camera(
            CameraOptions.model_validate(
                {"bench": "seen", "profile": "ideal", "scene": "white", "bands": 32, "samples": 16, "lamp": lamp}
            )
        )
        light = SimulatedLight(LightOptions(bench="seen"))
        await camera.connect()
        if level_by_frame is not None:
            await light.connect()
        await camera.configure(CameraSettings(0.01, 0.0, PixelFormat.MONO12, ROI))
        await camera.arm(Trigger.SOFTWARE, 4)
        means: list[float] = []
        for on in level_by_frame or [True]:
            if level_by_frame is not None:
                await (light.on() if on else light.off())
            await camera.expose()
            frame = await anext(camera.frames())
            assert isinstance(frame, Frame)
            pixels = np.zeros(ROI.shape, np.uint16)
            await camera.unpack(frame, pixels)
            means.append(float(pixels.mean()))
        await camera.close()
        if level_by_frame is not None:
            await light.close()
        return means

    return clock.run(main(), virtual=True)


def test_the_camera_sees_nothing_unless_it_is_on() -> None:
    alone = seen(None)[0]
    dark, lit, dark_again = seen([False, True, False])
    assert lit == pytest.approx(alone, rel=0.02)
    assert dark < 0.2 * lit
    assert dark_again < 0.2 * lit


def test_its_age_counts_from_switching_it_on() -> None:
    """Switched on anew, a lamp that overshoots is as bright as it was at first."""
    first, later, _, anew = seen([True, True, False, True], warm_up=0.5, warm_up_s=0.05)
    assert later < 0.95 * first
    assert anew == pytest.approx(first, rel=0.02)
