"""Simulated devices of scanhsi: camera, actuator and light on one bench, with delays from profiles and pixels from scenes."""

from scanhsi.devices import Actuator, Backend, Camera, Light
from scanhsi_sim.actuator import SimulatedActuator
from scanhsi_sim.camera import OverlappingCamera, create_camera
from scanhsi_sim.light import LightOptions, SimulatedLight
from scanhsi_sim.options import ActuatorOptions, CameraOptions, actuator_timing, camera_timing
from scanhsi_sim.truth import Truth, truth

__all__ = [
    "ActuatorOptions",
    "CameraOptions",
    "LightOptions",
    "Truth",
    "actuator_backend",
    "camera_backend",
    "light_backend",
    "truth",
]

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

light_backend: Backend[Light] = Backend(
    summary="Simulated light: the camera on its bench sees nothing while it is off",
    options=LightOptions,
    device=SimulatedLight,
    create=SimulatedLight,
    virtual_time=True,
)
