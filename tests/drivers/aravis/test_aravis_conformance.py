"""The suite for drivers, on the real camera driver against the camera twin."""

import pytest
from aravis_twin import Twin

from scanhsi.testing.conformance import CameraConformance
from scanhsi_aravis import AravisCamera, AravisOptions


@pytest.mark.twin
class TestAravisCamera(CameraConformance):
    exposure_s = 0.005
    shape = (64, 256)
    loses_frames = True  # the host may be too busy to receive a packet

    @pytest.fixture(autouse=True)
    def _on_the_twin(self, twin: Twin) -> None:
        self.address = twin.address

    def make(self) -> AravisCamera:
        return AravisCamera(AravisOptions(address=self.address))
