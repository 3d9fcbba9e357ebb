"""The real engine against the bound, in virtual time: it loses nothing, and one that waits too long is caught."""

from __future__ import annotations

import numpy as np
import pytest

from scanhsi import open_instrument
from scanhsi.clock import now_ns, run_virtual, sleep_until_ns
from scanhsi.cube.sink import DiscardSink
from scanhsi.devices import CameraSettings, Exposure, PixelFormat
from scanhsi.engine import Course, Mode, ScanReport, run_scan
from scanhsi.engine.scan import CAMERA_BUFFERS
from scanhsi.imager import default_plan
from scanhsi.instrument import InstrumentConfig, load_instrument
from scanhsi.instrument.timing import timing_of
from scanhsi.timing.bounds import LineDelays, bound, earliest_starts
from scanhsi.timing.observed import delays_of, exposure_starts
from scanhsi.timing.prediction import predict
from support.bench import Bench, BenchActuator, BenchCamera, MemorySink

LINES = 600
AT_MOST = 1.0005
FORMATS = (PixelFormat.MONO8, PixelFormat.MONO12_PACKED, PixelFormat.MONO12)
EXPOSURES_MS = (10, 20, 50, 100, 300)


@pytest.fixture(scope="module")
def config() -> InstrumentConfig:
    return load_instrument("sensors2019", {"camera.scene": "dark"})


class WideSink(DiscardSink):
    """Discards with more line buffers than the camera has frame buffers, and keeps the records."""

    def __init__(self) -> None:
        super().__init__(capacity=64)

    async def open(self, records) -> None:
        self.records = records
        await super().open(records)


def scan(config: InstrumentConfig, *, lines: int = LINES, **plan: object) -> tuple[ScanReport, WideSink, LineDelays]:
    sink = WideSink()

    async def main() -> tuple[ScanReport, LineDelays]:
        async with open_instrument(config) as imager:
            course = imager.course(default_plan(config, lines=lines, step=2, **plan))
            report = await run_scan(course, imager.camera, imager.actuator, sink)
            _, realised = delays_of(
                sink.records.stamps,
                exposure_ns=round(course.settings.exposure_s * 1e9),
                readout_ns=round(imager.camera.info.readout_s * 1e9),
                dead_ns=0,
                overlap=True,
                buffers=CAMERA_BUFFERS,
            )
            return report, realised

    report, realised = run_virtual(main())
    return report, sink, realised


@pytest.mark.parametrize("exposure_ms", EXPOSURES_MS)
@pytest.mark.parametrize("pixel_format", FORMATS)
def test_stepped_reaches_its_bound(config: InstrumentConfig, exposure_ms: int, pixel_format: PixelFormat) -> None:
    report, _, _ = scan(config, mode="stepped", exposure=f"{exposure_ms} ms", pixel_format=pixel_format)
    assert report.missing == 0
    assert report.regret is not None
    assert 1.0 <= report.regret <= AT_MOST


@pytest.mark.parametrize("exposure_ms", EXPOSURES_MS)
@pytest.mark.parametrize("pixel_format", FORMATS)
def test_continuous_reaches_its_bound(config: InstrumentConfig, exposure_ms: int, pixel_format: PixelFormat) -> None:
    """With the period that the engine chooses by itself, and without losing a line."""
    report, sink, _ = scan(
        config, lines=1200, mode="continuous", exposure=f"{exposure_ms} ms", pixel_format=pixel_format
    )
    drawn = timing_of(config).delays(1200, exposure_ms * 1e-3, pixel_format, 2)
    stamps = sink.records.stamps
    reached = bound(stamps["exposure_start"], stamps["copied"], drawn, "continuous")
    assert reached is not None
    assert 1.0 <= reached.regret <= AT_MOST, "against the delays drawn"
    assert report.missing == 0
    assert report.regret is not None
    assert 1.0 <= report.regret <= AT_MOST


@pytest.mark.parametrize("seed", range(100, 106))
def test_few_frames_wait_in_the_camera_where_the_link_sets_the_pace(config: InstrumentConfig, seed: int) -> None:
    """The period that the engine chooses does not know the delays to come; the camera's memory levels them out."""
    report, sink, _ = scan(
        config.with_seed(seed), lines=1200, mode="continuous", exposure="10 ms", pixel_format=PixelFormat.MONO12_PACKED
    )
    ends, received = (sink.records.stamps[stage] for stage in ("exposure_end", "received"))
    waiting = np.arange(1, 1201) - np.searchsorted(received, ends, "right")  # as an exposure ends, itself among them
    assert report.missing == 0
    assert 2 <= waiting.max() <= 4


def test_a_sweep_faster_than_the_link_loses_lines_once_the_memory_is_full(config: InstrumentConfig) -> None:
    report, _, _ = scan(
        config, lines=200, mode="continuous", exposure="10 ms", pixel_format=PixelFormat.MONO12_PACKED, period="25 ms"
    )
    assert 0 < report.missing < 200
    assert any("memory is full" in reason for reason in report.missing_reasons.values())


@pytest.mark.parametrize("mode", ["sequential", "stepped"])
@pytest.mark.parametrize("exposure_ms", [10, 50])
@pytest.mark.parametrize("pixel_format", FORMATS)
def test_the_prediction_is_the_scan(
    config: InstrumentConfig, mode: str, exposure_ms: int, pixel_format: PixelFormat
) -> None:
    exposure_s = exposure_ms * 1e-3
    timing = timing_of(config)
    report, sink, _ = scan(config, mode=mode, exposure=f"{exposure_ms} ms", pixel_format=pixel_format)
    starts = exposure_starts(sink.records.stamps)
    foreseen = earliest_starts(timing.delays(LINES, exposure_s, pixel_format, 2), mode)
    assert np.abs(starts - starts[0] - foreseen).max() <= LINES  # each wait of the loop is rounded to the ns
    told = predict(timing, mode, pixel_format, exposure_s=exposure_s, lines=LINES, step=2)
    assert report.duration_s == pytest.approx(told.scan_s, rel=1e-3)


class AfterTheFrame(BenchCamera):
    """Makes the engine a worse one: the mirror is let go only when the frame has arrived."""

    async def expose(self) -> Exposure:
        exposure = await super().expose()
        await sleep_until_ns(max(self._link_free_ns, now_ns()))
        return exposure


@pytest.mark.parametrize(("kind", "worse"), [(BenchCamera, False), (AfterTheFrame, True)])
@pytest.mark.parametrize("exposure_ms", [20, 100])
def test_an_engine_that_moves_after_the_frame_is_caught(
    kind: type[BenchCamera], worse: bool, exposure_ms: float
) -> None:
    bench = Bench(exposure_ms=exposure_ms, transfer_ms=18.16, readout_ms=10, copy_ms=0.5, move_ms=11)
    steps = np.arange(60, dtype=np.int64)
    course = Course(Mode.STEPPED, CameraSettings(exposure_ms * 1e-3, 0.0, PixelFormat.MONO12), steps, steps * 0.1)

    async def main() -> ScanReport:
        return await run_scan(course, kind(bench), BenchActuator(bench), MemorySink(capacity=64))

    report = run_virtual(main())
    assert report.regret is not None
    assert (report.regret > 1.1) if worse else (report.regret <= AT_MOST)
