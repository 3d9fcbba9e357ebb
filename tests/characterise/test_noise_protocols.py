"""Photon transfer, signal to noise and the lamp, from simulated acquisitions in virtual time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import scanhsi
from scanhsi.calibration.light import LightStability
from scanhsi.calibration.photon_transfer import PhotonTransfer
from scanhsi.calibration.snr import SignalToNoise
from scanhsi.characterise.aids import FoundExposure, Sharpness, auto_exposure, focus_score
from scanhsi.clock import run_virtual
from scanhsi.devices.errors import CalibrationError
from scanhsi.instrument import InstrumentConfig, load_instrument

SMALL = {
    "roi.samples": 120,
    "roi.bands": 60,
    "roi.sample_offset": 960,
    "roi.band_offset": 380,
    "camera.scene": "white",
    "scan.exposure": "20 ms",
}
READ_E, FULL_E, OFFSET_E, PRNU = 13.0, 13_500.0, 100.0, 0.01
GAIN = 4095 / FULL_E


def small(**settings: object) -> InstrumentConfig:
    return load_instrument(
        "sensors2019", {**SMALL, **{key.replace("__", "."): value for key, value in settings.items()}}
    )


def test_photon_transfer_finds_the_sensor(tmp_path: Path) -> None:
    async def main() -> PhotonTransfer:
        async with scanhsi.open_instrument(small()) as hsi:
            return await hsi.calibrate.photon_transfer(tmp_path / "ptc.nc")

    found = run_virtual(main())
    assert abs(found.gain / GAIN - 1) < 0.02
    assert abs(found.read_noise_e / READ_E - 1) < 0.02
    # EMVA's saturation, the largest variance, comes before the mean pixel is full: noise, PRNU and light clip the brightest first.
    assert 0.91 < found.saturation_e / FULL_E < 1.0
    assert abs(found.full_well_e / (FULL_E - OFFSET_E) - 1) < 0.02  # the converter's full scale, above the offset
    assert abs(found.prnu / PRNU - 1) < 0.15
    assert found.linearity_error < 0.01


def test_signal_to_noise_is_that_of_shot_and_read_noise() -> None:
    async def main() -> SignalToNoise:
        async with scanhsi.open_instrument(small()) as hsi:
            return await hsi.calibrate.snr(exposures_s=[0.01, 0.04], frames=12)

    found = run_virtual(main())
    for row, exposure in enumerate(found.exposure_s):
        electrons = 158e3 * exposure  # of the brightest bands
        expected = 20 * np.log10(electrons / np.sqrt(electrons + READ_E**2 + 125 * exposure))
        assert abs(np.nanmax(found.snr_db[row]) - expected) < 1.0
        # Eq. 20 on a reflectance of 0.99 differs from the usual by 10 log10(0.99)
        np.testing.assert_allclose(found.snr_paper_db[row], found.snr_db[row] + 10 * np.log10(1 / 0.99), atol=1e-6)


def test_a_lamp_that_settles_is_seen_to() -> None:
    warm = {"camera__lamp": {"warm_up": 0.05, "warm_up_s": 100.0}}

    async def main() -> LightStability:
        async with scanhsi.open_instrument(small(**warm)) as hsi:
            return await hsi.calibrate.light(exposure_s=0.03)

    found = run_virtual(main())
    assert abs(found.settling_s - 100) < max(3 * found.settling_sigma_s, 5)
    assert abs(found.overshoot - 0.05) < 0.005


def test_auto_exposure_uses_the_range_and_no_more() -> None:
    async def main() -> tuple[FoundExposure, FoundExposure]:
        async with scanhsi.open_instrument(small()) as hsi:
            return await auto_exposure(hsi, start_s=2.0), await auto_exposure(hsi, start_s=0.01)

    for found in run_virtual(main()):
        assert abs(found.level - 0.85) <= 0.03
        assert not found.limited
        assert found.frames <= 6


def test_auto_exposure_in_the_dark_says_so() -> None:
    async def main() -> None:
        async with scanhsi.open_instrument(small(camera__scene="dark")) as hsi:
            await auto_exposure(hsi)

    with pytest.raises(CalibrationError, match="no light"):
        run_virtual(main())


def test_a_sharper_lens_scores_higher() -> None:
    async def main(blur: float) -> Sharpness:
        config = small(camera__scene="slanted-lines", camera__optics={"blur_px": blur})
        async with scanhsi.open_instrument(config) as hsi:
            return await focus_score(hsi)

    assert run_virtual(main(0.5)).spatial > 1.3 * run_virtual(main(3.0)).spatial
