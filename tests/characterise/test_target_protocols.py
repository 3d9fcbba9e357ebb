"""Geometry, jitter, resolution and wavelengths from simulated acquisitions with all errors on, against the truth."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

import scanhsi
from scanhsi.calibration.geometry import Geometry
from scanhsi.calibration.jitter import Jitter
from scanhsi.calibration.resolution import EdgeResponse
from scanhsi.calibration.wavelength import Wavelength
from scanhsi.clock import run_virtual
from scanhsi.instrument import InstrumentConfig, load_instrument
from scanhsi_sim.options import ActuatorOptions, CameraOptions
from scanhsi_sim.truth import Truth, truth

FEW_BANDS = {"roi.samples": 600, "roi.bands": 8, "roi.sample_offset": 724, "roi.band_offset": 480}
EXPOSURE_S = 0.04


def instrument(**settings: object) -> InstrumentConfig:
    return load_instrument("characterise", {**FEW_BANDS, **settings})


def truth_of(config: InstrumentConfig) -> Truth:
    camera, actuator = config.camera.options, config.actuator.options
    assert isinstance(camera, CameraOptions)
    assert isinstance(actuator, ActuatorOptions)
    return truth(camera, actuator)


def test_distance_is_found_within_half_a_millimetre_from_21_lines_of_a_grid() -> None:
    config = instrument(**{"actuator.mirror.misalignment_steps": 0.0})

    async def main() -> Geometry:
        async with scanhsi.open_instrument(config) as hsi:
            return await hsi.calibrate.geometry(exposure_s=EXPOSURE_S)

    found, true = run_virtual(main()), truth_of(config)
    assert found.points == 21
    assert abs(found.distance_mm - true.geometry.distance_mm) < 0.5
    assert abs(found.normal_step - true.geometry.normal_step) < 0.5
    assert abs(found.sample_pitch_mm / true.geometry.pixel_mm - 1) < 0.002
    assert found.provenance.simulated is True


def test_jitter_is_found_within_a_tenth_although_a_shaft_is_out_of_true() -> None:
    config = instrument()

    async def main() -> Jitter:
        async with scanhsi.open_instrument(config) as hsi:
            return await hsi.calibrate.jitter(exposure_s=EXPOSURE_S)

    found, true = run_virtual(main()), truth_of(config)
    assert abs(found.sigma_mm / true.jitter_mm - 1) < 0.1
    assert found.raw_mm > 1.3 * found.sigma_mm
    assert abs(found.turn_steps / 320 - 1) < 0.1  # nobody said which shaft it is


def half_contrast(sigma_mm: float, box_mm: float) -> float:
    """Frequency at which a Gaussian and a box leave half of the contrast."""
    frequency = np.linspace(0.01, 5, 5000)
    transfer = np.exp(-2 * np.pi**2 * sigma_mm**2 * frequency**2) * np.sinc(box_mm * frequency)
    return float(frequency[np.argmax(transfer < 0.5)])


def edge(axis: Literal["line", "sample"], scans: int = 1) -> tuple[EdgeResponse, Truth]:
    config = instrument(**{"actuator.mirror.misalignment_steps": 0.0, "actuator.mirror.periodic_steps": 0.0})

    async def main() -> EdgeResponse:
        async with scanhsi.open_instrument(config) as hsi:
            return await hsi.calibrate.resolution(axis=axis, scans=scans, exposure_s=EXPOSURE_S)

    return run_virtual(main()), truth_of(config)


def test_transfer_along_the_slit_is_that_of_lens_and_sample() -> None:
    found, true = edge("sample")
    assert abs(found.mtf50_per_mm / half_contrast(true.blur_mm, true.geometry.pixel_mm) - 1) < 0.03


def test_transfer_along_the_scan_is_that_of_lens_slit_and_jitter() -> None:
    found, true = edge("line", scans=4)
    expected = half_contrast(math.hypot(true.blur_mm, true.jitter_mm), true.slit_mm)
    assert abs(found.mtf50_per_mm / expected - 1) < 0.1


def test_wavelengths_are_found_to_a_hundredth_of_a_nanometre() -> None:
    config = load_instrument("characterise", {"roi.samples": 40, "roi.bands": 1088, "roi.sample_offset": 1004})

    async def main() -> Wavelength:
        async with scanhsi.open_instrument(config) as hsi:
            return await hsi.calibrate.wavelength(frames=6)

    found, true = run_virtual(main()), truth_of(config)
    assert np.sqrt(np.mean((found.nm() - true.wavelength_nm) ** 2)) < 0.02
    assert abs(found.fwhm_nm(650.0) / 2.9 - 1) < 0.03
