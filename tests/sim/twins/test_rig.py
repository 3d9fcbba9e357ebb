"""Both twins as one instrument, through the real drivers: pixels tell the step the firmware has counted."""

import asyncio

import numpy as np
import pytest

from scanhsi.devices.camera import CameraSettings, Roi, Trigger
from scanhsi.devices.capabilities import Sweep
from scanhsi.devices.frames import Frame
from scanhsi.devices.pixels import PixelFormat
from scanhsi_aravis import AravisCamera, AravisOptions
from scanhsi_sim.scenes.testpattern import Decoded, decode
from scanhsi_sim.twins.rig import TwinRig
from scanhsi_stepper import StepperActuator, StepperOptions

pytestmark = pytest.mark.twin

ROI = Roi(sample_offset=128, band_offset=64, samples=64, bands=32)


async def seen(camera: AravisCamera, frame: Frame) -> Decoded:
    pixels = np.empty(frame.shape, np.uint16)
    await camera.unpack(frame, pixels)
    return decode(pixels, (ROI.band_offset, ROI.sample_offset))


async def take(camera: AravisCamera, count: int) -> list[Decoded]:
    taken: list[Decoded] = []
    async for frame in camera.frames():
        assert isinstance(frame, Frame), frame
        taken.append(await seen(camera, frame))
        if len(taken) == count:
            break
    return taken


async def connected(rig: TwinRig) -> tuple[AravisCamera, StepperActuator]:
    camera = AravisCamera(AravisOptions(address=rig.camera_address))
    actuator = StepperActuator(StepperOptions(port=rig.port))
    await asyncio.gather(camera.connect(), actuator.connect())
    await actuator.home()
    await camera.configure(CameraSettings(exposure_s=0.005, pixel_format=PixelFormat.MONO12_PACKED, roi=ROI))
    return camera, actuator


async def stepped(steps: list[int]) -> list[Decoded]:
    async with TwinRig() as rig:
        camera, actuator = await connected(rig)
        await camera.arm(Trigger.SOFTWARE, 8)
        frames = asyncio.create_task(take(camera, len(steps)))
        for step in steps:
            await actuator.move_to(step)
            await camera.expose()
        taken = await frames
        await camera.close()
        await actuator.close()
        assert (await rig.camera.stats())["smeared"] == 0
        assert rig.stepper.open_mirror().read().wrapped() == steps[-1]
    return taken


def test_each_frame_shows_the_step_that_the_mirror_stood_at() -> None:
    steps = [0, 3, 4, 60, 20]
    assert asyncio.run(stepped(steps)) == [Decoded(step, moved=False) for step in steps]


async def swept(sweep: Sweep) -> tuple[list[Decoded], dict[str, int]]:
    async with TwinRig() as rig:
        camera, actuator = await connected(rig)
        sweep = actuator.check_sweep(sweep)
        await actuator.prepare_sweep(sweep)
        await camera.arm(Trigger.LINE, 16)
        frames = asyncio.create_task(take(camera, sweep.count))
        await actuator.sweep(sweep)
        taken = await frames
        await camera.close()
        await actuator.close()
        return taken, await rig.camera.stats()


def test_the_firmwares_trigger_pulses_expose_at_their_steps() -> None:
    sweep = Sweep(first=100, every=8, count=12, rate_steps_s=160, pulses=True)
    taken, stats = asyncio.run(swept(sweep))
    assert [frame.step for frame in taken] == [100 + 8 * line for line in range(12)]
    assert (stats["exposures"], stats["busy"], stats["ignored"]) == (12, 0, 0)


async def moved_too_early() -> Decoded:
    async with TwinRig() as rig:
        camera, actuator = await connected(rig)
        await camera.configure(CameraSettings(exposure_s=0.3, pixel_format=PixelFormat.MONO12_PACKED, roi=ROI))
        await camera.arm(Trigger.SOFTWARE, 8)
        exposure = asyncio.create_task(camera.expose())
        await asyncio.sleep(0.1)
        await actuator.move_to(5)
        await exposure
        (frame,) = await take(camera, 1)
        await camera.close()
        await actuator.close()
    return frame


def test_a_move_during_an_exposure_is_in_the_pixels() -> None:
    assert asyncio.run(moved_too_early()) == Decoded(0, moved=True)
