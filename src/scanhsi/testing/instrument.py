"""A plan's faults around a whole instrument, whatever its drivers."""

from __future__ import annotations

from functools import cache
from typing import Any, Self

from pydantic import PrivateAttr

from scanhsi.devices import Actuator, Backend, Camera, Light, find
from scanhsi.instrument import ActuatorConfig, CameraConfig, DeviceConfig, InstrumentConfig, LightConfig
from scanhsi.testing.faults import NO_FAULTS, Faults
from scanhsi.testing.faulty_actuator import faulty_actuator
from scanhsi.testing.faulty_camera import faulty_camera
from scanhsi.testing.faulty_light import FaultyLight
from scanhsi.testing.witness import Witness

_find = cache(find)  # thousands of instruments are made, and looking through entry points takes 10 ms


class _Failing(DeviceConfig):
    _faults: Faults = PrivateAttr(default_factory=lambda: Faults(NO_FAULTS))
    _witness: Witness = PrivateAttr(default_factory=Witness)

    @property
    def backend(self) -> Backend[Any]:
        return _find(self.role, self.driver)

    def fail(self, faults: Faults, witness: Witness) -> Self:
        self._faults, self._witness = faults, witness
        return self


class _FailingCamera(_Failing, CameraConfig):
    def create(self) -> Camera:
        return faulty_camera(super().create(), self._faults, self._witness)


class _FailingActuator(_Failing, ActuatorConfig):
    def create(self) -> Actuator:
        return faulty_actuator(super().create(), self._faults, self._witness)


class _FailingLight(_Failing, LightConfig):
    def create(self) -> Light:
        return FaultyLight(super().create(), self._faults)


def with_faults(config: InstrumentConfig, faults: Faults, witness: Witness | None = None) -> InstrumentConfig:
    """The instrument with its devices failing as a plan says: give it to `scanhsi.open_instrument`.

    Args:
        config: Any instrument.
        faults: The plan under way.
        witness: Told what truly happens, where the devices are simulated.
    """
    witness = witness or Witness(keeps=False)
    camera = _FailingCamera.model_construct(driver=config.camera.driver, options=config.camera.options)
    actuator = _FailingActuator.model_construct(driver=config.actuator.driver, options=config.actuator.options)
    failing: dict[str, DeviceConfig] = {
        "camera": camera.fail(faults, witness),
        "actuator": actuator.fail(faults, witness),
    }
    if config.light is not None:
        light = _FailingLight.model_construct(driver=config.light.driver, options=config.light.options)
        failing["light"] = light.fail(faults, witness)
    return config.model_copy(update=failing)
