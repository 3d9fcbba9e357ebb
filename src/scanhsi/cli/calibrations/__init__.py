"""The kinds of ``scanhsi calibrate``: options of their own, what they take, and how cubes that exist are worked out."""

from __future__ import annotations

from typing import Final

from scanhsi.cli.calibrations import mirror, optics, sensor, spectrograph
from scanhsi.cli.calibrations.work import Kind

KINDS: Final[tuple[Kind, ...]] = (
    sensor.dark,
    sensor.white,
    sensor.photon_transfer,
    sensor.snr,
    sensor.light,
    spectrograph.wavelength,
    spectrograph.wavelength_tile,
    spectrograph.smile,
    spectrograph.keystone,
    optics.geometry,
    optics.resolution,
    mirror.jitter,
    mirror.backlash,
    mirror.repeatability,
)
"""In the order in which a new instrument is characterised."""
