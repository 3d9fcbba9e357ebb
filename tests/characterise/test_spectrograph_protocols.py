"""Smile, keystone and the wavelength tile from simulated acquisitions, hot pixels and all, against the truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import scanhsi
import scanhsi_sim
from scanhsi.calibration.keystone import Keystone
from scanhsi.calibration.lines import load_lines
from scanhsi.calibration.smile import Smile
from scanhsi.calibration.wavelength import Wavelength
from scanhsi.characterise.lamp_from_cubes import tile_from_cubes
from scanhsi.clock import run_virtual
from scanhsi.devices.errors import CalibrationError
from scanhsi.instrument import load_instrument
from scanhsi_sim import Truth, truth
from scanhsi_sim.options import CameraOptions

SAMPLES = 360
SETTINGS = {"camera.samples": SAMPLES, "roi.samples": SAMPLES, "roi.sample_offset": 0, "actuator.home_s": 0.0}
CONFIG = load_instrument("characterise", SETTINGS)
CERTIFICATE = Path(scanhsi_sim.__file__).parent / "data" / "wavelength_tile.csv"


def real() -> Truth:
    camera = CONFIG.camera.options
    assert isinstance(camera, CameraOptions)
    return truth(camera)


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> tuple[Smile, Keystone, Wavelength, Path]:
    folder = tmp_path_factory.mktemp("spectrograph")

    async def main() -> tuple[Smile, Keystone, Wavelength, Path]:
        async with scanhsi.open_instrument(CONFIG) as hsi:
            return (
                await hsi.calibrate.smile(exposure_s=0.1, frames=5),
                await hsi.calibrate.keystone(exposure_s=0.04, frames=4),
                await hsi.calibrate.wavelength_tile(
                    load_lines(CERTIFICATE), folder / "tile.nc", exposure_s=0.04, frames=8
                ),
                folder / "tile-cubes",
            )

    return run_virtual(main())


def test_the_smile_is_that_of_the_slit(found: tuple[Smile, Keystone, Wavelength, Path]) -> None:
    smile, true = found[0], real().smile_bands
    middle = smile.shift(544, np.arange(SAMPLES)) - (true - true[SAMPLES // 2])
    assert np.abs(middle).max() < 0.03
    assert smile.provenance.simulated is True


def test_the_keystone_is_that_of_the_spectrograph(found: tuple[Smile, Keystone, Wavelength, Path]) -> None:
    keystone, true = found[1], real().keystone_samples
    error = keystone.shift() - (true - true[544])
    assert np.sqrt(np.mean(error**2)) < 0.03


def test_wavelengths_from_the_tile_are_those_of_the_bands(found: tuple[Smile, Keystone, Wavelength, Path]) -> None:
    error = found[2].nm() - real().wavelength_nm
    assert found[2].bands == 1088
    assert np.sqrt(np.mean(error**2)) < 0.05


def test_a_tile_needs_the_white_one_beside_it(found: tuple[Smile, Keystone, Wavelength, Path]) -> None:
    cubes = [found[3] / "wavelength-tile.zarr", found[3] / "dark.zarr"]
    with pytest.raises(CalibrationError, match="one of the white tile are needed, not of wavelength-tile"):
        tile_from_cubes(cubes, load_lines(CERTIFICATE))
