"""State, capabilities, camera, mirror, live view, STOP."""

from __future__ import annotations

import platform
from importlib.metadata import version

from fastapi import APIRouter

from scanhsi.devices import ShowsScenes
from scanhsi.devices.capabilities import capabilities_of
from scanhsi.engine import Mode
from scanhsi.service.calibrations import CALIBRATIONS
from scanhsi.service.downloads import FORMATS
from scanhsi.service.jobs import plain
from scanhsi.service.models import (
    CameraModel,
    CameraPatch,
    CapabilitiesModel,
    GoTo,
    Jog,
    MirrorModel,
    ReopenBody,
    SceneBody,
    StateModel,
    SwitchBody,
)
from scanhsi.service.routes.common import IN_CONTROL, StationHere, problems
from scanhsi.service.station import MirrorState

router = APIRouter()


@router.get("/state", tags=["instrument"], responses=problems())
async def get_state(station: StationHere) -> StateModel:
    """How things stand."""
    return StateModel(**station.state())


@router.get("/capabilities", tags=["instrument"], responses=problems())
async def get_capabilities(station: StationHere) -> CapabilitiesModel:
    """What the instrument is and allows."""
    imager = station.imager
    instrument, config = imager.instrument, imager.config
    info = instrument.camera_info
    shape = config.roi.roi.shape if config.roi else (info.bands, info.samples)
    offset = config.roi.band_offset if config.roi else 0
    camera = imager.camera
    return CapabilitiesModel(
        name=config.name,
        description=config.description,
        simulated=instrument.simulated,
        camera=plain(info),
        actuator=plain(instrument.actuator_info),
        abilities={
            "camera": list(capabilities_of(camera)),
            "actuator": list(capabilities_of(imager.actuator)),
        },
        scenes=list(camera.scenes) if isinstance(camera, ShowsScenes) else [],
        config=config.model_dump(mode="json"),
        default_plan=imager.default_plan().model_dump(mode="json"),
        shape=shape,
        wavelength_nm=config.spectral.wavelengths_nm(shape[0], offset).tolist() if config.spectral else None,
        modes=list(Mode),
        calibrations=list(CALIBRATIONS),
        formats=list(FORMATS),
        versions={"scanhsi": version("scanhsi"), "python": platform.python_version()},
    )


@router.post("/devices/reopen", tags=["instrument"], dependencies=[IN_CONTROL], responses=problems(409, 503, 504))
async def reopen_devices(station: StationHere, body: ReopenBody) -> StateModel:
    """Open devices anew that were lost, or do not seem well; one attempt. Nothing moves; the live view ends."""
    await station.reopen(*body.devices)
    return StateModel(**station.state())


@router.post("/stop", tags=["mirror"], responses=problems(503, 504))
async def stop(station: StationHere) -> MirrorModel:
    """STOP: the mirror, and whatever would move it again. Needs no control."""
    return _mirror(await station.stop())


@router.get("/camera", tags=["camera"], responses=problems())
async def get_camera(station: StationHere) -> CameraModel:
    """Settings of the camera."""
    return CameraModel(**station.settings_json())


@router.patch("/camera", tags=["camera"], dependencies=[IN_CONTROL], responses=problems(409))
async def set_camera(station: StationHere, body: CameraPatch) -> CameraModel:
    """Change settings: of the live view, and of plans that say nothing else."""
    await station.set_camera(exposure_s=body.exposure_s, gain_db=body.gain_db, pixel_format=body.pixel_format)
    return CameraModel(**station.settings_json())


@router.put("/live", tags=["camera"], dependencies=[IN_CONTROL], responses=problems(409, 503, 504))
async def set_live(station: StationHere, body: SwitchBody) -> StateModel:
    """Switch the live view on or off; its frames come over the WebSocket `/api/v1/preview`."""
    await station.set_live(body.on)
    return StateModel(**station.state())


@router.put("/scene", tags=["camera"], dependencies=[IN_CONTROL], responses=problems(409, 503, 504))
async def set_scene(station: StationHere, body: SceneBody) -> StateModel:
    """Put something else before a simulated camera."""
    await station.show_scene(body.scene)
    return StateModel(**station.state())


@router.get("/mirror", tags=["mirror"], responses=problems())
async def get_mirror(station: StationHere) -> MirrorModel:
    """Where the mirror is."""
    return _mirror(station.mirror)


@router.post("/mirror/home", tags=["mirror"], dependencies=[IN_CONTROL], responses=problems(409, 503, 504))
async def home_mirror(station: StationHere) -> MirrorModel:
    """Find the home position; answers when it is found."""
    return _mirror(await station.home())


@router.post("/mirror/goto", tags=["mirror"], dependencies=[IN_CONTROL], responses=problems(409, 503, 504))
async def move_mirror(station: StationHere, body: GoTo) -> MirrorModel:
    """Move the mirror to a step; answers when it stands there. The normal step is the mirror at 45 degrees."""
    return _mirror(await station.go_to(body.step))


@router.post("/mirror/jog", tags=["mirror"], dependencies=[IN_CONTROL], responses=problems(409, 503, 504))
async def jog_mirror(station: StationHere, body: Jog) -> MirrorModel:
    """Move the mirror by some steps."""
    return _mirror(await station.jog(body.steps))


@router.post("/mirror/stop", tags=["mirror"], responses=problems(503, 504))
async def stop_mirror(station: StationHere) -> MirrorModel:
    """The same as `/stop`. Needs no control."""
    return _mirror(await station.stop())


def _mirror(state: MirrorState) -> MirrorModel:
    return MirrorModel(step=state.step, homed=state.homed, angle_rad=state.angle_rad, moving=state.moving)
