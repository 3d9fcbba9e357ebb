"""Lost packets and a lost camera: each test has a fake of its own, for there is one address."""

import pytest
from genicam_helpers import scan, with_camera

from scanhsi.devices import Frame, FrameGap
from scanhsi.devices.errors import DeviceLost
from scanhsi_genicam import GenicamCamera
from support.genicam_fake import FakeCamera


@pytest.mark.twin
def test_lost_packets_are_a_gap_and_the_next_frame_comes() -> None:
    fake = FakeCamera(dropped=[(2, 1)])

    async def scenario(camera: GenicamCamera) -> None:
        events: list[object] = []
        for _ in range(3):
            await camera.expose()
            events.append(await anext(camera.frames()))
        whole, gap, next_one = events
        assert isinstance(whole, Frame)
        assert isinstance(gap, FrameGap)
        assert (gap.first, gap.count) == (1, 1)
        assert "missing" in gap.reason
        assert isinstance(next_one, Frame)
        assert next_one.index == 2

    try:
        with_camera(scenario)
    finally:
        fake.close()


@pytest.mark.twin
def test_unplugged_in_mid_scan() -> None:
    fake = FakeCamera()

    async def scenario(camera: GenicamCamera) -> None:
        await camera.expose()
        await anext(camera.frames())
        fake.kill()
        with pytest.raises(DeviceLost):
            await scan(camera)

    try:
        with_camera(scenario)
    finally:
        fake.close()
