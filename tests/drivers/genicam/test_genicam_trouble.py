"""The GenICam driver when things go wrong, against the fake camera of its library."""

import numpy as np
import pytest
from genicam_helpers import SETTINGS, scan, with_camera

from scanhsi.devices import CameraSettings, Frame, PixelFormat, Roi, Trigger
from scanhsi.devices.errors import (
    DeviceBusy,
    DeviceError,
    DeviceLost,
    DeviceNotFound,
    DeviceTimeout,
    OutOfRange,
    ProtocolError,
    UnsupportedFeature,
)
from scanhsi_genicam import GenicamCamera
from scanhsi_genicam.errors import classify
from support.genicam_fake import FakeCamera


@pytest.mark.twin
def test_frames_of_triggers_and_what_it_is(fake: FakeCamera) -> None:
    async def scenario(camera: GenicamCamera) -> None:
        assert camera.info.simulated
        assert (camera.info.bands, camera.info.samples) == (4096, 4096)
        before = int(fake.tell("triggers"))
        stamps: list[int] = []
        for index in range(3):
            await camera.expose()
            frame = await anext(camera.frames())
            assert isinstance(frame, Frame)
            assert (frame.index, frame.shape) == (index, (32, 64))
            pixels = np.zeros(frame.shape, np.uint8)
            await camera.unpack(frame, pixels)
            assert pixels.any()
            assert frame.device_ns is not None
            stamps.append(frame.device_ns)
        assert stamps == sorted(stamps)
        assert int(fake.tell("triggers")) == before + 3

    with_camera(scenario)


@pytest.mark.twin
def test_by_its_mac_address(fake: FakeCamera) -> None:
    async def scenario(camera: GenicamCamera) -> None:
        await camera.expose()

    with_camera(scenario, address="de:ad:be:ef:ca:fe")


@pytest.mark.twin
def test_a_region_that_is_too_small_changes_nothing(fake: FakeCamera) -> None:
    async def scenario(camera: GenicamCamera) -> None:
        await camera.disarm()
        with pytest.raises(OutOfRange, match="below 16 px"):
            await camera.configure(CameraSettings(0.02, 0.0, PixelFormat.MONO16, Roi(0, 0, 64, 8)))
        await camera.arm(Trigger.SOFTWARE, 4)
        await camera.expose()
        frame = await anext(camera.frames())
        assert isinstance(frame, Frame)
        assert (frame.shape, frame.pixel_format) == ((32, 64), PixelFormat.MONO8)

    with_camera(scenario)


@pytest.mark.twin
def test_nobody_there(fake: FakeCamera) -> None:
    async def scenario(camera: GenicamCamera) -> None:
        raise AssertionError("connected to nobody")

    with pytest.raises(DeviceNotFound, match="UDP 3956"):
        with_camera(scenario, address="127.0.0.9")


@pytest.mark.twin
def test_control_taken_away_is_a_lost_camera(fake: FakeCamera) -> None:
    async def scenario(camera: GenicamCamera) -> None:
        await camera.expose()
        await anext(camera.frames())
        fake.tell("revoke")
        with pytest.raises(DeviceLost):
            await scan(camera)
        with pytest.raises(DeviceLost):
            await camera.expose()
        await camera.close()
        await camera.connect()
        await camera.configure(SETTINGS)
        await camera.arm(Trigger.SOFTWARE, 4)
        await camera.expose()
        assert isinstance(await anext(camera.frames()), Frame)

    with_camera(scenario)


@pytest.mark.parametrize(
    ("words", "kind"),
    [
        ("claim control: device reported status ACCESS_DENIED (0x8006)", DeviceBusy),
        ("claim control: timeout waiting for acknowledgement", DeviceBusy),
        ("register I/O failed: control of the camera was lost, so nothing is written", DeviceLost),
        ("register I/O failed: io: Connection refused (os error 111)", DeviceLost),
        ("ExposureTime: 1000000000000 is above the maximum 1000000", OutOfRange),
        ("enum PixelFormat has no entry named Mono12p", UnsupportedFeature),
        ("node not found: Nope", UnsupportedFeature),
        ("timeout waiting for frame", DeviceTimeout),
        ("something else", ProtocolError),
    ],
)
def test_what_the_library_says_has_its_error(words: str, kind: type[DeviceError]) -> None:
    assert classify(words) is kind
