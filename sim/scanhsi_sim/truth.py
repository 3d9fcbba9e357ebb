"""What a simulated instrument really is, number by number: to compare a calibration with."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanhsi_sim.effects import LampOptions, MirrorOptions, Setup, TargetOptions
from scanhsi_sim.geometry import Geometry
from scanhsi_sim.lamp import settled
from scanhsi_sim.optics import wavelengths
from scanhsi_sim.options import ActuatorOptions, CameraOptions
from scanhsi_sim.scenes import TILES
from scanhsi_sim.scenes.surfaces import tile_reflectance
from scanhsi_sim.sensor import Sensor, sensor_of

Floats = NDArray[np.floating[Any]]


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """The simulated instrument as it is. Maps are of the whole sensor, (band, sample); a ROI is a slice of them.

    Attributes:
        dark_e_per_s: Dark current, hot pixels included.
        offset_e: Black level.
        response: Of each pixel, 1 on average; its standard deviation is the PRNU.
        hot, nonlinear: Hot pixels, and those of them whose dark signal levels off; bool.
        read_noise_e, full_well_e, full_scale_e: In electrons; full scale is that of the ADC at 0 dB.
        dispersion: Polynomial of the wavelength in nm over the channel = band / 5, constant first.
        wavelength_nm: Of each band in the middle of the slit, (band,).
        lsf_fwhm_bands, lsf_fwhm_nm: Full width at half maximum of a line: one number in bands, (band,) in nm.
        smile_bands: By which a spectral line lies at higher bands than in the middle, (sample,).
        keystone_samples: By which something lies farther along the slit than at the middle wavelength, (band, sample).
        vignetting: Share of the light that arrives, (sample,).
        geometry: Distance, normal step, tilt and pitch of samples; ``geometry.y_mm(step)``.
        principal_sample: Sample of the sensor that looks straight.
        step_rad: Turn of the mirror a step.
        jitter_mm: Standard deviation of the jitter in the object plane, straight ahead.
        blur_mm, slit_mm: Standard deviation of the lens's point spread function, and width of the slit, straight ahead.
        mirror, lamp, target: Options, as they are: jitter, periodic error, misalignment and backlash in steps; warm-up; places.
        reflectance: Of the scene in each band, (band,), where it has one for all places; else None.
    """

    dark_e_per_s: Floats
    offset_e: Floats
    response: Floats
    hot: NDArray[np.bool_]
    nonlinear: NDArray[np.bool_]
    read_noise_e: float
    full_well_e: float
    full_scale_e: float
    dispersion: tuple[float, ...]
    wavelength_nm: Floats
    lsf_fwhm_bands: float
    lsf_fwhm_nm: Floats
    smile_bands: Floats
    keystone_samples: Floats
    vignetting: Floats
    geometry: Geometry
    principal_sample: float
    step_rad: float
    jitter_mm: float
    blur_mm: float
    slit_mm: float
    mirror: MirrorOptions
    lamp: LampOptions
    target: TargetOptions
    reflectance: Floats | None
    _sensor: Sensor
    _setup: Setup

    def gain(self, gain_db: float = 0.0, bits: int = 12) -> float:
        """System gain K, counts an electron."""
        return self._sensor.counts_per_electron(gain_db, bits)

    def dark(self, exposure_s: float, gain_db: float = 0.0, bits: int = 12) -> Floats:
        """Mean dark counts, before rounding, full well and full scale included, (band, sample)."""
        electrons = np.minimum(self._sensor.dark_e(exposure_s), self.full_well_e) + self.offset_e
        return np.minimum(electrons * self.gain(gain_db, bits), (1 << bits) - 1)

    def lamp_level(self, time_s: float) -> float:
        """Brightness of the lamp over the settled one, a time after the camera connected, without flicker."""
        return settled(self._setup, time_s)


def truth(camera: CameraOptions, actuator: ActuatorOptions | None = None) -> Truth:
    """The truth about a simulated instrument.

    Args:
        camera: Options of its camera.
        actuator: Options of its actuator; one without errors by default.
    """
    setup, mirror = camera.setup(), (actuator or ActuatorOptions()).mirror
    optics, geometry = setup.optics, setup.geometry
    sensor = sensor_of(geometry.sensor, setup.seed, setup.sensor)
    wavelength = wavelengths(setup)
    bands, samples = geometry.sensor
    across, skew = np.linspace(-1, 1, samples), np.linspace(-1, 1, bands)
    fwhm_bands = optics.lsf_fwhm_nm / float(np.mean(np.diff(wavelength))) if bands > 1 else math.nan
    step_rad = 2 * math.pi / geometry.steps_per_revolution
    return Truth(
        dark_e_per_s=sensor.dark_e_per_s,
        offset_e=sensor.offset_e,
        response=sensor.response,
        hot=sensor.hot,
        nonlinear=sensor.nonlinear,
        read_noise_e=setup.sensor.read_noise_e,
        full_well_e=setup.sensor.full_well_e,
        full_scale_e=setup.sensor.full_scale_e or setup.sensor.full_well_e,
        dispersion=optics.wavelength_nm,
        wavelength_nm=wavelength,
        lsf_fwhm_bands=fwhm_bands,
        lsf_fwhm_nm=fwhm_bands * (np.gradient(wavelength) if bands > 1 else np.full(1, math.nan)),
        smile_bands=optics.smile_px * across**2,
        keystone_samples=optics.keystone_px * skew[:, None] * across,
        vignetting=1 - optics.vignetting * across**2,
        geometry=geometry,
        principal_sample=(samples - 1) / 2,
        step_rad=step_rad,
        jitter_mm=2 * step_rad * geometry.distance_mm * mirror.jitter_steps,
        blur_mm=optics.blur_px * geometry.pixel_mm,
        slit_mm=optics.slit_px * geometry.pixel_mm,
        mirror=mirror,
        lamp=setup.lamp,
        target=setup.target,
        reflectance=_reflectance(camera.scene, setup, wavelength),
        _sensor=sensor,
        _setup=setup,
    )


def _reflectance(scene: str, setup: Setup, wavelength: NDArray[np.float64]) -> Floats | None:
    if scene == "wavelength-tile":
        return tile_reflectance(wavelength, setup.target.certificate)
    level = 0.0 if scene == "dark" else TILES.get(scene)
    return None if level is None else np.full(len(wavelength), level)
