"""Simulated devices of scanhsi: camera and actuator on one bench, with delays from profiles and pixels from scenes."""

from scanhsi.devices import Actuator, Backend, Camera
from scanhsi_sim.actuator import SimulatedActuator
from scanhsi_sim.camera import OverlappingCamera, create_camera
from scanhsi_sim.options import ActuatorOptions, CameraOptions, actuator_timing, camera_timing
from scanhsi_sim.truth import Truth, truth

__all__ = ["ActuatorOptions", "CameraOptions", "Truth", "actuator_backend", "camera_backend", "truth"]

camera_backend: Backend[Camera] = Backend(
    summary="Simulated hyperspectral camera: delays of a profile, pixels of a scene",
    options=CameraOptions,
    device=OverlappingCamera,
    create=create_camera,
    virtual_time=True,
    timing=camera_timing,
)

actuator_backend: Backend[Actuator] = Backend(
    summary="Simulated rotating mirror: delays of a profile, position triggers",
    options=ActuatorOptions,
    device=SimulatedActuator,
    create=SimulatedActuator,
    virtual_time=True,
    timing=actuator_timing,
)
