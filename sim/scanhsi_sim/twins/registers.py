"""The camera twin's registers: their addresses (see ``mako.xml``), their values at power-on, and what they ask for."""

from scanhsi_sim.twins.fake import FakeCamera
from scanhsi_sim.twins.payload import MONO12_PACKED
from scanhsi_sim.twins.sensor import Settings, Source

WIDTH, HEIGHT, OFFSET_X, OFFSET_Y, FORMAT = 0x100, 0x104, 0x130, 0x134, 0x128
SENSOR_HEIGHT, SENSOR_WIDTH = 0x118, 0x11C
GAIN, EXPOSURE, ACQUISITION = 0x110, 0x120, 0x124
TEMPERATURE, PERIOD, TRIGGER_MODE, TRIGGER_SOURCE, TRIGGER_SOFTWARE, RATE = (
    0x500,
    0x504,
    0x50C,
    0x510,
    0x518,
    0x51C,
)
VENDOR, MODEL, VERSION = 0x48, 0x68, 0x88
SENSOR_BANDS, SENSOR_SAMPLES = 1088, 2048


def power_on(camera: FakeCamera) -> None:
    """Give the registers the values that a camera has after power-on."""
    camera.write_text(VENDOR, "Allied Vision Technologies")
    camera.write_text(MODEL, "Mako G-223B (twin)")
    camera.write_text(VERSION, "1.0.0")
    for address, value in {
        SENSOR_WIDTH: SENSOR_SAMPLES,
        SENSOR_HEIGHT: SENSOR_BANDS,
        WIDTH: SENSOR_SAMPLES,
        HEIGHT: SENSOR_BANDS,
        FORMAT: MONO12_PACKED,
        EXPOSURE: 10_000,
        PERIOD: 50_000,
        TEMPERATURE: 43_000,
        RATE: 115_000_000,
    }.items():
        camera.write(address, value)


def read_settings(camera: FakeCamera) -> Settings:
    """What the registers say now."""
    triggered = camera.read(TRIGGER_MODE) == 1
    return Settings(
        source=Source(camera.read(TRIGGER_SOURCE)) if triggered else Source.FIXED_RATE,
        exposure_us=camera.read(EXPOSURE),
        period_us=camera.read(PERIOD),
        gain_tenths=camera.read(GAIN),
        pixel_format=camera.read(FORMAT),
        shape=(camera.read(HEIGHT), camera.read(WIDTH)),
        offset=(camera.read(OFFSET_Y), camera.read(OFFSET_X)),
    )
