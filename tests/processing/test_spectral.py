from dataclasses import replace

import numpy as np
import pytest

from scanhsi import clock
from scanhsi.calibration.conditions import Conditions
from scanhsi.calibration.keystone import Keystone
from scanhsi.calibration.result import Provenance
from scanhsi.calibration.smile import Smile, calibrate_spectrograph
from scanhsi.calibration.wavelength import Wavelength, calibrate_with_lamp
from scanhsi.cube.layout import CubeSpec
from scanhsi.cube.reader import open_cube
from scanhsi.cube.repack import repack
from scanhsi.devices.errors import CalibrationError
from scanhsi.processing import (
    AssignWavelength,
    BinBands,
    CorrectKeystone,
    CorrectSmile,
    MaskSaturated,
    Pipeline,
    Signal,
    process,
)
from support.cubes import write_cube
from support.lamps import TRUTH_NM, lamp, noisy

SAMPLES = 160
T = (np.arange(SAMPLES) - (SAMPLES - 1) / 2) / (SAMPLES / 2)
BENT = 0.3 * T + 0.8 * T**2
ROI = {"bands": 1088, "samples": SAMPLES, "band_offset": 0}
TAKEN = Provenance(("lamp.zarr",), Conditions(0.1, 0.0, "Mono12", ROI))
RAW = Signal(
    bands=1088,
    samples=SAMPLES,
    dtype=np.dtype(np.uint16),
    units="counts",
    long_name="raw camera counts",
    saturation=4095,
    wavelength_nm=None,
    conditions=Conditions(0.02, 6.0, "Mono12", ROI),
)


@pytest.fixture(scope="module")
def calibrated() -> tuple[Wavelength, Smile]:
    return calibrate_spectrograph(noisy(lamp(BENT), 1, 50), TAKEN)


def test_lines_of_the_lamp_are_straight_afterwards(calibrated):
    wavelength, smile = calibrated
    lines = np.rint(noisy(lamp(BENT), 2, 50)).clip(0, 4094).astype(np.uint16)[:, None, :]
    pipeline = Pipeline(RAW, [MaskSaturated(), AssignWavelength(wavelength), CorrectSmile(smile)])
    out = pipeline(lines)[:, 0]
    assert pipeline.output.wavelength_nm == pytest.approx(TRUTH_NM, abs=0.03)
    green = slice(315, 340)
    place = np.arange(1088)[green, None]

    def centroid(values: np.ndarray) -> np.ndarray:
        light = values[green] - np.median(values[green], axis=0)
        return (light * place).sum(axis=0) / light.sum(axis=0)

    before, after = centroid(lines[:, 0].astype(float)), centroid(out)
    assert np.ptp(before) > 0.7
    assert np.std(after) < 0.02
    assert np.nansum(out[10:-10]) == pytest.approx(lines[10:-10].sum(), rel=2e-3)


def test_data_may_stay_as_they_are_and_know_the_wavelength_of_every_pixel(calibrated, tmp_path):
    wavelength, smile = calibrated
    spec = CubeSpec(
        lines=6,
        bands=1088,
        samples=SAMPLES,
        dtype=np.uint16,
        significant_bits=12,
        attributes={"plan": {"exposure_s": 0.02, "gain_db": 6.0, "pixel_format": "Mono12"}, "instrument": {"roi": ROI}},
    )
    clock.run(write_cube(tmp_path / "raw.zarr", spec), virtual=True)
    process(tmp_path / "raw.zarr", tmp_path / "out.zarr", [AssignWavelength(wavelength, smile)])
    raw, out = open_cube(tmp_path / "raw.zarr"), open_cube(tmp_path / "out.zarr")
    np.testing.assert_array_equal(out["cube"].values, raw["cube"].values)
    assert out["wavelength_map"].dims == ("band", "sample")
    np.testing.assert_array_equal(out["wavelength_map"].values, smile.wavelength_map(wavelength))
    assert out["wavelength_map"].attrs["units"] == "nm"
    assert out.attrs["processing"][-1]["smile"] == ["lamp.zarr"]
    process(tmp_path / "out.zarr", tmp_path / "binned.zarr", [MaskSaturated(), BinBands(4)])
    binned = open_cube(tmp_path / "binned.zarr")
    expected = smile.wavelength_map(wavelength).reshape(272, 4, SAMPLES).mean(axis=1)
    np.testing.assert_allclose(binned["wavelength_map"].values, expected)
    repack(tmp_path / "out.zarr")
    np.testing.assert_array_equal(
        open_cube(tmp_path / "out.zarr")["wavelength_map"].values, smile.wavelength_map(wavelength)
    )


def test_keystone_is_straightened():
    keystone = Keystone(
        bands=100,
        samples=SAMPLES,
        coefficients=np.array([[0.4, 0.8], [0.0, 0.0]]),
        coefficients_sigma=np.zeros((2, 2)),
        residual_samples=0.0,
        band=np.zeros(0),
        sample=np.zeros(0),
        moved=np.zeros((0, 0)),
        provenance=Provenance(),
    )
    sample = np.arange(SAMPLES)
    edge = 1 / (1 + np.exp(-(sample - 90 - keystone.shift()) / 2.5))  # what falls on a sample falls that much further
    signal = replace(RAW, bands=100, conditions=Conditions(), units="1", saturation=None)
    out = Pipeline(signal, [CorrectKeystone(keystone)])(edge[:, None, :].astype(np.float32))[:, 0]
    assert np.std(edge, axis=0).max() > 0.02
    assert np.nanstd(out[:, 5:-5], axis=0).max() < 0.003


def test_what_does_not_fit_is_refused_with_the_reason(calibrated):
    wavelength, smile = calibrated
    with pytest.raises(CalibrationError, match="before saturated pixels are masked"):
        Pipeline(RAW, [CorrectSmile(smile)])
    with pytest.raises(CalibrationError, match="1088x160 bands and samples, not 218x160"):
        Pipeline(RAW, [MaskSaturated(), BinBands(5), CorrectSmile(smile)])
    with pytest.raises(CalibrationError, match="1088 bands, not 218x160"):
        Pipeline(RAW, [MaskSaturated(), BinBands(5), AssignWavelength(wavelength)])
    moved = replace(RAW, conditions=replace(RAW.conditions, roi={**ROI, "band_offset": 8}))
    with pytest.raises(CalibrationError, match="region"):
        Pipeline(moved, [AssignWavelength(wavelength)])
    other = calibrate_with_lamp(noisy(lamp(), 3, 50), Provenance())
    assert Pipeline(RAW, [AssignWavelength(other)]).output.wavelength_map_nm is None


def test_provenance_names_the_sources(calibrated):
    wavelength, smile = calibrated
    described = Pipeline(RAW, [MaskSaturated(), AssignWavelength(wavelength), CorrectSmile(smile)]).describe()
    assert described[1]["source"] == ["lamp.zarr"]
    assert len(described[1]["coefficients_nm"]) == 3
    assert described[2]["kind"] == "cubic"
    assert described[2]["largest_bands"] == pytest.approx(np.ptp(BENT), abs=0.02)
