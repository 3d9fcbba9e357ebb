"""Driver for a controller with GRBL 1.1 on a serial port, one axis of which turns the mirror."""

from scanhsi.devices.actuator import Actuator
from scanhsi.devices.registry import Backend
from scanhsi_grbl.actuator import GrblActuator
from scanhsi_grbl.options import GrblOptions

backend: Backend[Actuator] = Backend(
    summary="GRBL 1.1 controller (Arduino with a CNC shield) on a serial port, one axis",
    options=GrblOptions,
    device=GrblActuator,
    create=GrblActuator,
)

__all__ = ["GrblActuator", "GrblOptions", "backend"]
