"""The device contracts as tests: whoever writes a driver inherits them and hears where it breaks a promise.

In a test module of the driver, with pytest::

    from scanhsi.testing.conformance import ActuatorConformance
    from my_package import Stage, StageOptions


    class TestStage(ActuatorConformance):
        def make(self):
            return Stage(StageOptions(port="/dev/ttyUSB0"))

The tests run the device in an event loop of their own, in virtual time where ``virtual`` says so. What a real device needs (a port,
a process, a private network) belongs into a fixture of the class: ``@pytest.fixture(autouse=True)``.
"""

from scanhsi.testing.actuators import ActuatorConformance
from scanhsi.testing.cameras import CameraConformance
from scanhsi.testing.lights import LightConformance

__all__ = ["ActuatorConformance", "CameraConformance", "LightConformance"]
