"""Wavelength, smile and keystone from scans of the simulated instrument with all errors on, against its own truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import scanhsi
from scanhsi.calibration.keystone import fit_keystone
from scanhsi.calibration.lines import line_list
from scanhsi.calibration.reference import average
from scanhsi.calibration.result import Provenance
from scanhsi.calibration.smile import calibrate_spectrograph
from scanhsi.calibration.tile import calibrate_with_tile
from scanhsi.clock import run_virtual
from scanhsi.instrument import load_instrument
from scanhsi_sim import Truth, truth
from scanhsi_sim.options import ActuatorOptions, CameraOptions

SAMPLES = 360
SMALL: dict[str, object] = {
    "camera.samples": SAMPLES,
    "roi.samples": SAMPLES,
    "roi.sample_offset": 0,
    "actuator.home_s": 0.0,
}


def seen(folder: Path, scene: str, exposure: str, lines: int) -> tuple[np.ndarray, Truth]:
    """Mean frame, dark-corrected, nan where saturated or hot, and what the instrument is."""
    frames = []
    config = load_instrument("characterise", SMALL)
    for target in ("dark", scene):
        config = load_instrument("characterise", {**SMALL, "camera.scene": target})
        path = folder / f"{target}.zarr"

        async def scan(config=config, path=path) -> None:
            async with scanhsi.open_instrument(config) as hsi:
                plan = hsi.default_plan(pixel_format="Mono12", lines=lines, exposure=exposure, start=0)
                await hsi.scan(plan, path)

        run_virtual(scan())
        frames.append(average(path).mean.astype(np.float64))
    camera, actuator = config.camera.options, config.actuator.options
    assert isinstance(camera, CameraOptions)
    assert isinstance(actuator, ActuatorOptions)
    real = truth(camera, actuator)
    frame = frames[1] - frames[0]
    frame[real.hot] = np.nan
    return frame, real


def filled(frame: np.ndarray) -> np.ndarray:
    """Single unknown pixels by the mean of their neighbours along the slit."""
    out = frame.copy()
    for band, sample in np.argwhere(np.isnan(frame)):
        out[band, sample] = np.nanmean(frame[band, max(0, sample - 3) : sample + 4])
    return out


def test_wavelengths_and_smile_of_the_instrument(tmp_path: Path) -> None:
    frame, real = seen(tmp_path, "hgar", "100 ms", 12)
    wavelength, smile = calibrate_spectrograph(filled(frame), Provenance(("hgar.zarr",)))
    error = wavelength.nm() - real.wavelength_nm
    middle = smile.shift(544, np.arange(SAMPLES)) - (real.smile_bands - real.smile_bands[SAMPLES // 2])
    assert np.sqrt(np.mean(error**2)) < 0.05
    assert np.abs(middle).max() < 0.03
    np.testing.assert_allclose(
        wavelength.fwhm_nm([450, 600, 850]),
        np.interp([450, 600, 850], real.wavelength_nm, real.lsf_fwhm_nm),
        rtol=0.02,
    )


def test_keystone_of_the_instrument(tmp_path: Path) -> None:
    frame, real = seen(tmp_path, "slanted-lines", "30 ms", 3)
    found = fit_keystone(filled(frame), Provenance())
    middle = real.keystone_samples - real.keystone_samples[544]
    error = found.shift() - middle
    assert np.sqrt(np.mean(error**2)) < 0.03


def test_wavelengths_from_the_tile(tmp_path: Path) -> None:
    (tmp_path / "white").mkdir()
    tile, real = seen(tmp_path, "wavelength-tile", "40 ms", 12)
    white, _ = seen(tmp_path / "white", "white", "40 ms", 12)
    table = np.loadtxt(Path(truth.__code__.co_filename).parent / "data/wavelength_tile.csv", delimiter=",", skiprows=3)
    used = slice(30, 1075)  # where there is light
    middle = slice(150, 210)
    reflectance = np.nanmean(tile[used, middle], axis=1) / np.nanmean(white[used, middle], axis=1)
    found = calibrate_with_tile(reflectance, line_list("tile", table[:, 0]), Provenance(), fwhm_bands=16)
    error = found.nm() - real.wavelength_nm[used]
    assert np.sqrt(np.mean(error**2)) < 0.3
