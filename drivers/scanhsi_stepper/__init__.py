"""Driver for the mirror stepper: an Arduino Uno with the scanhsi stepper firmware (see ``firmware/``) on a serial port."""

from scanhsi.devices.actuator import Actuator
from scanhsi.devices.registry import Backend
from scanhsi_stepper.actuator import StepperActuator
from scanhsi_stepper.options import StepperOptions

backend: Backend[Actuator] = Backend(
    summary="Arduino with the scanhsi stepper firmware and a DRV8825, on a serial port",
    options=StepperOptions,
    device=StepperActuator,
    create=StepperActuator,
)

__all__ = ["StepperActuator", "StepperOptions", "backend"]
