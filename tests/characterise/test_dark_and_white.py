"""Dark model and white reference from simulated acquisitions, in virtual time, against the sensor's own truth."""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

import scanhsi
from scanhsi.calibration.applies import Limits
from scanhsi.calibration.dark import DarkModel
from scanhsi.calibration.result import load
from scanhsi.calibration.white import WhiteReference
from scanhsi.clock import now_ns, run_virtual
from scanhsi.devices.errors import CalibrationError, CubeExists
from scanhsi.instrument import InstrumentConfig, load_instrument
from scanhsi_sim.sensor import DARK_E_PER_S, FULL_WELL_E, OFFSET_E

K = 4095 / FULL_WELL_E
SMALL = {
    "roi.samples": 100,
    "roi.bands": 40,
    "roi.sample_offset": 1000,
    "roi.band_offset": 500,
    "camera.scene": "testpattern",
    "scan.exposure": "20 ms",
}


def small() -> InstrumentConfig:
    return load_instrument("sensors2019", SMALL)


def test_dark_current_and_offset_are_those_of_the_sensor(tmp_path: Path) -> None:
    async def main() -> DarkModel:
        async with scanhsi.open_instrument(small()) as hsi:
            return await hsi.calibrate.dark(tmp_path / "dark.nc")

    model = run_virtual(main())
    assert abs(np.median(model.offset) - OFFSET_E * K) < 0.2
    assert abs(np.mean(model.rate[~model.hot]) / (DARK_E_PER_S * K) - 1) < 0.03
    again = load(DarkModel, tmp_path / "dark.nc")
    np.testing.assert_array_equal(again.rate, model.rate)
    assert again.provenance.simulated is True
    assert again.provenance.conditions.exposure_s is None
    assert len(again.provenance.sources) == 8
    cubes = sorted((tmp_path / "dark-cubes").iterdir())
    assert [scanhsi.open_cube(cube).attrs["target"] for cube in cubes] == ["dark"] * 8


def test_a_white_reference_finds_its_exposure_and_masks_next_to_nothing(tmp_path: Path) -> None:
    async def main() -> WhiteReference:
        async with scanhsi.open_instrument(small()) as hsi:
            dark = await hsi.calibrate.dark(exposures_s=[0.01, 0.2], frames=10)
            return await hsi.calibrate.white(tmp_path / "white.nc", dark=dark)

    white = run_virtual(main())
    assert 0.8 < np.nanpercentile(white.mean, 99) / 4095 < 0.9
    assert white.saturated.sum() <= 4  # hot pixels
    assert np.isnan(white.mean[white.saturated]).all()
    signal = white.mean - white.dark
    assert np.nanmedian(white.sigma / signal) < 0.005  # 20 frames of 10^4 electrons: 0.2 %
    assert load(WhiteReference, tmp_path / "white.nc").exposure_s == white.exposure_s


def test_cubes_of_an_earlier_run_are_not_touched(tmp_path: Path) -> None:
    (tmp_path / "dark-cubes").mkdir()

    async def main() -> None:
        async with scanhsi.open_instrument(small()) as hsi:
            await hsi.calibrate.dark(tmp_path / "dark.nc")

    with pytest.raises(CubeExists, match="dark-cubes is there already"):
        run_virtual(main())
    assert not list((tmp_path / "dark-cubes").iterdir())


def test_a_dark_model_of_another_gain_is_refused() -> None:
    async def main() -> None:
        async with scanhsi.open_instrument(small()) as hsi:
            dark = await hsi.calibrate.dark(exposures_s=[0.01, 0.2], frames=3)
        async with scanhsi.open_instrument(load_instrument("sensors2019", {**SMALL, "scan.gain": "6 dB"})) as hsi:
            await hsi.calibrate.white(dark=dark, exposure_s=0.02, frames=3)

    with pytest.raises(CalibrationError, match=r"dark model does not apply: gain 0 dB instead of 6 dB"):
        run_virtual(main())


def test_a_dark_model_that_is_too_old_is_refused_before_anything_moves() -> None:
    async def main() -> WhiteReference:
        async with scanhsi.open_instrument(small()) as hsi:
            dark = await hsi.calibrate.dark(exposures_s=[0.01, 0.2], frames=3)
            taken = datetime.fromisoformat(dark.provenance.taken or "") - timedelta(days=45)
            old = replace(dark, provenance=replace(dark.provenance, taken=taken.isoformat()))
            began_ns = now_ns()
            with pytest.raises(
                CalibrationError, match="dark model does not apply: it is 45 d older than .*, 30 d at most"
            ):
                await hsi.calibrate.white(dark=old, exposure_s=0.02, frames=3)
            assert now_ns() == began_ns
            return await hsi.calibrate.within(Limits(timedelta.max)).white(dark=old, exposure_s=0.02, frames=3)

    assert run_virtual(main()).lines == 3


def test_a_dark_model_of_a_cooler_sensor_is_refused() -> None:
    warm = load_instrument("sensors2019", {**SMALL, "camera.sensor.temperature_c": 39.0})

    async def main() -> float:
        async with scanhsi.open_instrument(small()) as hsi:
            dark = await hsi.calibrate.dark(exposures_s=[0.01, 0.2], frames=3)
        async with scanhsi.open_instrument(warm) as hsi:
            with pytest.raises(CalibrationError, match=r"the sensor was at 25\.0 degC and is at 39\.0 degC"):
                await hsi.calibrate.white(dark=dark, exposure_s=0.02, frames=3)
            hot = await hsi.calibrate.dark(exposures_s=[0.01, 0.2], frames=3)
            assert hot.provenance.temperature_c == 39.0
            return float(np.median(hot.rate) / np.median(dark.rate))

    assert 3 < run_virtual(main()) < 5  # 14 K more: twice doubled


def test_the_camera_looks_at_its_own_scene_again_afterwards() -> None:
    async def main() -> list[str]:
        async with scanhsi.open_instrument(small()) as hsi:
            await hsi.calibrate.dark(exposures_s=[0.01, 0.2], frames=3)
            with pytest.raises(CalibrationError):
                await hsi.calibrate.dark(exposures_s=[0.01], frames=3)
            return [hsi.camera.scene]  # pyright: ignore[reportAttributeAccessIssue,reportUnknownMemberType,reportUnknownVariableType] simulated

    assert run_virtual(main()) == ["testpattern"]
