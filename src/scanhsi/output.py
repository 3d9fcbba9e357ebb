"""What the lines of a scan go to: the cube that says how they were taken, and what stands before it."""

from __future__ import annotations

import platform
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from importlib.metadata import version
from typing import Any

from scanhsi.calibration.online import online_quicklook
from scanhsi.cube import Binning, CubeSpec, CubeWriter, LineSink
from scanhsi.cube.destination import Destination
from scanhsi.cube.slow import SlowSink
from scanhsi.cube.watched import Watch, WatchedSink
from scanhsi.devices.errors import ConfigError
from scanhsi.engine import Course, ScanPlan
from scanhsi.instrument import Instrument, InstrumentConfig
from scanhsi.instrument.timing import storing_of


def cube_spec(instrument: Instrument, course: Course, plan: ScanPlan, session: Mapping[str, Any]) -> CubeSpec:
    """The cube of a scan.

    Args:
        instrument: That takes it.
        course: What the plan comes to on it.
        plan: As it was asked for.
        session: Attributes that say which session took it, and how.

    Raises:
        ConfigError: The instrument file asks for what cannot be stored.
    """
    settings, roi, config = course.settings, course.settings.roi, instrument.config
    assert roi is not None, "Instrument.check fills the ROI in"
    spectral, storage = config.spectral, config.storage
    wavelength_nm = spectral.wavelengths_nm(roi.bands, roi.band_offset) if spectral else None
    with _refused_as_config():
        return CubeSpec(
            lines=course.lines,
            bands=roi.bands,
            samples=roi.samples,
            dtype=settings.pixel_format.dtype,
            significant_bits=settings.pixel_format.bits,
            attributes={
                "simulated": instrument.simulated,
                "plan": plan.model_dump(mode="json"),
                "instrument": config.model_dump(mode="json"),
                "devices": instrument.describe(),
                "versions": {"scanhsi": version("scanhsi"), "python": platform.python_version()},
                **session,
            },
            wavelength_nm=wavelength_nm,
            binning=Binning(storage.bin_bands, storage.bin_samples),
            quicklook=online_quicklook(roi.bands, wavelength_nm) if storage.quicklook else None,
        )


def new_writer(config: InstrumentConfig, place: Destination, spec: CubeSpec) -> CubeWriter:
    """A writer of a new cube, stored as the instrument file says.

    Raises:
        ConfigError: It cannot be stored so.
    """
    storage = config.storage
    with _refused_as_config():
        return CubeWriter(
            place, spec, lines_per_shard=storage.lines_per_shard, codec=storage.codec, durability=storage.durability
        )


def slowed(sink: LineSink, config: InstrumentConfig, plan: ScanPlan) -> LineSink:
    """The sink, taking the time that the delays of a simulated instrument say."""
    storing = storing_of(config)
    if storing is None:
        return sink
    return SlowSink(sink, lambda line: storing.delay_ns("T_store", line, pixel_format=plan.pixel_format))


def watched(sink: LineSink, watch: Watch, course: Course, period_s: float = 0.0) -> WatchedSink:
    """The sink, with somebody who is shown each line on its way there; see `scanhsi.cube.watched`."""
    settings = course.settings
    assert settings.roi is not None, "Instrument.check fills the ROI in"
    return WatchedSink(sink, watch, settings.roi.shape, settings.pixel_format, period_s)


@contextmanager
def _refused_as_config() -> Generator[None]:
    try:
        yield
    except ValueError as error:
        raise ConfigError("the cube cannot be stored as asked:", [str(error)]) from error
