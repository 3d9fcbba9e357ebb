"""The suite for drivers, on the drivers of our own, and on bad ones that it must catch."""

from scanhsi.devices import Role, find
from scanhsi.testing.conformance import ActuatorConformance, CameraConformance


class TestSimulatedCamera(CameraConformance):
    virtual = True

    def make(self):
        backend = find(Role.CAMERA, "simulated")
        return backend.create(backend.options(bands=40, samples=64, scene="testpattern"))


class TestSimulatedActuator(ActuatorConformance):
    virtual = True

    def make(self):
        backend = find(Role.ACTUATOR, "simulated")
        return backend.create(backend.options())


class TestSimulatedCameraInRealTime(CameraConformance):
    def make(self):
        backend = find(Role.CAMERA, "simulated")
        return backend.create(backend.options(bands=40, samples=64, scene="testpattern", profile="ideal"))
