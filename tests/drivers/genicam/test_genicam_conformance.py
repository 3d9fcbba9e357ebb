"""The suite for drivers, on the GenICam driver against the fake camera of its library."""

import pytest

from scanhsi.testing.conformance import CameraConformance
from scanhsi_genicam import GenicamCamera, GenicamOptions


@pytest.mark.twin
@pytest.mark.usefixtures("fake")
class TestGenicamCamera(CameraConformance):
    exposure_s = 0.005
    loses_frames = True  # the host may be too busy to receive a packet

    def make(self) -> GenicamCamera:
        return GenicamCamera(GenicamOptions(address="127.0.0.1", interface="lo", discovery_s=0.05))
