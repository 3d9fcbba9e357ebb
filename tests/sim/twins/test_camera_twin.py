"""The camera's twin as an application on the network sees it: registers, formats, triggers, faults. A bare Aravis client."""

import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from scanhsi.devices.errors import DeviceUnavailable
from scanhsi_sim.scenes.testpattern import expected
from scanhsi_sim.twins.payload import BITS, MONO8, MONO12, MONO12_PACKED, MONO16, pack
from scanhsi_sim.twins.sensor import READOUT_NS
from support.aravis_client import armed, load, opened
from support.twins import Running, running

pytestmark = pytest.mark.twin

FORMATS = {"Mono8": MONO8, "Mono12": MONO12, "Mono12Packed": MONO12_PACKED, "Mono16": MONO16}
FULL = (0, 0, 2048, 1088)


@pytest.fixture(scope="module")
def still() -> Iterator[Running]:
    """A twin whose mirror stands at step 77."""
    with running(step=77) as twin:
        yield twin


@pytest.mark.usefixtures("still")
class TestWire:
    @pytest.mark.parametrize("pixel_format", FORMATS)
    def test_whole_sensor_arrives_bit_exact(self, pixel_format: str) -> None:
        code = FORMATS[pixel_format]
        with armed(pixel_format=pixel_format, region=FULL) as client:
            payload = client.shoot()
        np.testing.assert_array_equal(payload, pack(expected(77, (1088, 2048), bits=BITS[code]), code))

    @pytest.mark.parametrize("region", [(64, 32, 256, 128), (1984, 1054, 64, 34)])
    def test_a_region_is_cropped_out_of_the_sensor(self, region: tuple[int, int, int, int]) -> None:
        x, y, width, height = region
        with armed(region=region) as client:
            payload = client.shoot()
        np.testing.assert_array_equal(payload.reshape(height, width), expected(77, (height, width), (y, x), 8))

    def test_frame_ids_count_and_the_timestamp_is_the_start_of_exposure(self) -> None:
        with armed(exposure_us=50_000) as client:
            before = time.time_ns()
            client.trigger()
            acknowledged = time.time_ns()
            first = client.receive()
            time.sleep(0.03)
            client.trigger()
            second = client.receive()
        assert first is not None
        assert second is not None
        assert before - 1_000_000 <= first.timestamp_ns <= acknowledged + 1_000_000
        assert second.frame_id == first.frame_id % 65535 + 1

    def test_exposure_takes_its_time(self) -> None:
        with armed(exposure_us=300_000) as client:
            before = time.monotonic()
            client.shoot()
        assert time.monotonic() - before >= 0.3

    def test_the_camera_answers_while_it_exposes(self) -> None:
        with armed(exposure_us=1_000_000) as client:
            client.trigger()
            before = time.monotonic()
            assert client.camera.get_float("DeviceTemperature") == 43.0
            assert client.receive(0.001) is None, "the frame came before the exposure was over"
            assert time.monotonic() - before < 0.9
            assert client.receive() is not None

    def test_free_run_delivers_every_frame(self, still: Running) -> None:
        before = still.stats()
        with armed(source=None, rate_hz=40.0) as client:
            frames = [client.receive() for _ in range(20)]
        assert all(frame is not None and frame.good for frame in frames)
        times = [frame.timestamp_ns for frame in frames if frame]
        assert np.diff(times) == pytest.approx(25e6, abs=1e6)
        assert still.stats()["smeared"] == before["smeared"]

    def test_settings_may_change_between_acquisitions(self) -> None:
        for pixel_format, height in (("Mono8", 32), ("Mono12", 64), ("Mono8", 16)):
            code = FORMATS[pixel_format]
            with armed(pixel_format=pixel_format, region=(0, 0, 64, height)) as client:
                payload = client.shoot()
            np.testing.assert_array_equal(payload, pack(expected(77, (height, 64), bits=BITS[code]), code))

    def test_a_stopped_exposure_leaves_no_frame_behind(self) -> None:
        with armed(exposure_us=100_000) as client:
            client.trigger()
        with armed(pixel_format="Mono12", exposure_us=1000) as client:
            np.testing.assert_array_equal(client.shoot(), pack(expected(77, (32, 64)), MONO12))
            assert client.receive(0.2) is None


@pytest.mark.usefixtures("still")
class TestFeatures:
    @pytest.fixture
    def camera(self) -> Iterator[Any]:
        with opened() as client:
            yield client.camera

    def test_identity(self, camera: Any) -> None:
        assert camera.get_vendor_name() == "Allied Vision Technologies"
        assert "Mako G-223B" in camera.get_model_name()
        assert camera.get_device_serial_number()
        assert camera.get_sensor_size() == (2048, 1088)
        assert set(camera.dup_available_pixel_formats_as_strings()) == set(FORMATS)

    def test_limits(self, camera: Any) -> None:
        camera.set_region(0, 0, 2048, 1088)
        assert camera.get_exposure_time_bounds() == (21.0, 153e6)
        assert camera.get_float_bounds("Gain") == (0.0, 24.0)
        assert camera.get_frame_rate_bounds()[1] == pytest.approx(49.5, abs=0.01)
        assert camera.get_width_bounds() == (16, 2048)
        assert (camera.get_width_increment(), camera.get_height_increment()) == (8, 2)

    @pytest.mark.parametrize(
        ("feature", "value"), [("ExposureTimeAbs", 20.0), ("ExposureTimeAbs", 2e8), ("Gain", 24.1), ("Gain", -1.0)]
    )
    def test_values_outside_are_refused(self, camera: Any, feature: str, value: float) -> None:
        with pytest.raises(load()[1].Error):
            camera.set_float(feature, value)

    def test_offsets_keep_the_region_on_the_sensor(self, camera: Any) -> None:
        camera.set_region(0, 0, 1024, 544)
        assert camera.get_integer_bounds("OffsetX") == (0, 1024)
        assert camera.get_integer_bounds("OffsetY") == (0, 544)

    @pytest.mark.parametrize(("pixel_format", "size"), [("Mono8", 2048), ("Mono12Packed", 3072), ("Mono16", 4096)])
    def test_payload_size(self, camera: Any, pixel_format: str, size: int) -> None:
        camera.set_region(0, 0, 64, 32)
        camera.set_pixel_format_from_string(pixel_format)
        assert camera.get_payload() == size

    def test_gain_and_exposure_read_back(self, camera: Any) -> None:
        camera.set_float("Gain", 12.3)
        camera.set_float("ExposureTimeAbs", 100_000.0)
        assert camera.get_float("Gain") == pytest.approx(12.3)
        assert camera.get_float("ExposureTimeAbs") == 100_000.0
        camera.set_float("Gain", 0.0)


def test_a_software_trigger_during_an_exposure_is_lost(still: Running) -> None:
    before = still.stats()
    with armed(exposure_us=200_000) as client:
        client.trigger()
        client.trigger()
        assert client.receive() is not None
        assert client.receive(0.4) is None
    assert still.stats()["busy"] == before["busy"] + 1


def test_dropped_frames_are_missing_and_their_ids_too(still: Running) -> None:
    with armed() as client:
        client.trigger()
        first = client.receive()
        still.command("drop 2")
        for _ in range(2):
            time.sleep(READOUT_NS * 2e-9)
            client.trigger()
            assert client.receive(0.3) is None
        client.trigger()
        last = client.receive()
    assert first is not None
    assert last is not None
    assert (last.frame_id - first.frame_id) % 65535 == 3


def test_a_frozen_camera_is_silent_and_goes_on_when_thawed(still: Running) -> None:
    with armed() as client:
        still.command("freeze")
        with pytest.raises(load()[1].Error):
            client.camera.get_float("DeviceTemperature")
        still.command("thaw")
        assert client.camera.get_float("DeviceTemperature") == 43.0


def test_unknown_commands_are_named(still: Running) -> None:
    with pytest.raises(ValueError, match="explode"):
        still.command("explode")


def test_one_camera_an_address(capfd: pytest.CaptureFixture[str], still: Running) -> None:
    del still
    with pytest.raises(DeviceUnavailable), running():
        pass
    assert "already" in capfd.readouterr().err
