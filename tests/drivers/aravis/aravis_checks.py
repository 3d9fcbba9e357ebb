"""What the tests of a lost or troubled camera share."""

import asyncio

import pytest
from aravis_twin import Twin, threads

from scanhsi.clock import now_ns
from scanhsi.devices import CameraSettings, PixelFormat, Roi
from scanhsi.devices.errors import DeviceError, DeviceLost
from scanhsi_aravis import AravisCamera, AravisOptions

SMALL = CameraSettings(0.002, 0.0, PixelFormat.MONO8, Roi(64, 32, 256, 64))
SLACK_S = 1.5
"""For a busy machine; the deadlines themselves are the driver's."""


async def ready(twin: Twin) -> AravisCamera:
    device = AravisCamera(AravisOptions(address=twin.address, frame_timeout_s=0.6))
    await device.connect()
    await device.configure(SMALL)
    return device


async def until_error(device: AravisCamera) -> tuple[DeviceError, float]:
    """What ends the frames, and after how many seconds without any."""
    last_ns = now_ns()
    try:
        async with asyncio.timeout(20):
            async for _ in device.frames():
                last_ns = now_ns()
    except DeviceError as error:
        return error, (now_ns() - last_ns) * 1e-9
    raise AssertionError("the frames ended without an error")


async def check_lost_for_good(device: AravisCamera) -> None:
    """After `DeviceLost` every call says so, and closing is quick."""
    with pytest.raises(DeviceLost):
        await device.expose()
    with pytest.raises(DeviceLost):
        await anext(device.frames())
    started_ns = now_ns()
    await device.disarm()
    with pytest.raises(DeviceLost):
        await device.expose()
    with pytest.raises(DeviceLost):
        await device.configure(SMALL)
    await device.close()
    await device.close()
    assert now_ns() - started_ns < 1e9
    check_threads()
    with pytest.raises(DeviceError, match="not connected"):
        await device.configure(SMALL)


def check_threads() -> None:
    """None of ours; Aravis' own say goodbye to a camera that does not answer, for a while."""
    assert not [name for name in threads() if not name.startswith("arv_")]
