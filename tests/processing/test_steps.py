from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scanhsi.calibration.conditions import Conditions
from scanhsi.calibration.reference import Reference
from scanhsi.devices.errors import CalibrationError
from scanhsi.processing import BinBands, MaskSaturated, Pipeline, Reflectance, Signal, SubtractDark

BANDS, SAMPLES = 11, 7
TAKEN = Conditions(0.02, 3.0, "Mono12", {"bands": BANDS, "samples": SAMPLES, "band_offset": 0})
RAW = Signal(
    bands=BANDS,
    samples=SAMPLES,
    dtype=np.dtype(np.uint16),
    units="counts",
    long_name="raw camera counts",
    saturation=4095,
    wavelength_nm=np.linspace(400, 500, BANDS),
    conditions=TAKEN,
)


def reference(value: float, name: str = "ref.zarr", **conditions: object) -> Reference:
    ramp = np.linspace(0.9, 1.1, SAMPLES)[None, :] * np.linspace(1.0, 2.0, BANDS)[:, None]
    return Reference(name, (value * ramp).astype(np.float32), 10, replace(TAKEN, **conditions))


def test_reflectance_of_a_known_surface_is_recovered():
    dark, white = reference(100), reference(1100)
    truth = np.random.default_rng(1).uniform(0.05, 0.9, (BANDS, 5, SAMPLES))
    light = (white.mean - dark.mean)[:, None, :]
    pipeline = Pipeline(RAW, [MaskSaturated(), SubtractDark(dark), Reflectance(white, dark, tile=0.99)])
    out = pipeline(truth / 0.99 * light + dark.mean[:, None, :])
    np.testing.assert_allclose(out, truth, rtol=2e-5)
    assert pipeline.output.units == "1"
    assert out.dtype == np.float32


def test_exposures_of_cube_and_tile_may_differ():
    dark, white = reference(100), reference(1100, exposure_s=0.04)
    white_dark = reference(100, exposure_s=0.04)
    pipeline = Pipeline(RAW, [MaskSaturated(), SubtractDark(dark), Reflectance(white, white_dark)])
    half = (white.mean - dark.mean) / 2 + dark.mean  # as bright as the tile, in half the time
    np.testing.assert_allclose(pipeline(half), 1.0, rtol=1e-5)


def test_saturated_pixels_are_never_a_number_again():
    dark, white = reference(100), reference(1100)
    raw = np.full((BANDS, 4, SAMPLES), 900, np.uint16)
    raw[3, 2, 5] = 4095
    pipeline = Pipeline(RAW, [MaskSaturated(), SubtractDark(dark), Reflectance(white, dark), BinBands(5)])
    out = pipeline(raw)
    assert out.shape == (3, 4, SAMPLES)
    assert np.argwhere(np.isnan(out)).tolist() == [[0, 2, 5]]
    lower = Pipeline(RAW, [MaskSaturated(level=900)])
    assert np.isnan(lower(raw)).all()


def test_a_tile_without_light_gives_nan_not_a_large_number():
    dark, white = reference(100), reference(1100)
    white.mean[2, 3] = dark.mean[2, 3]
    out = Pipeline(RAW, [MaskSaturated(), Reflectance(white, dark)])(np.full((BANDS, SAMPLES), 200, np.uint16))
    assert np.argwhere(np.isnan(out)).tolist() == [[2, 3]]


@given(rows=st.integers(1, BANDS), lines=st.integers(1, 4))
@settings(max_examples=30)
def test_binned_bands_are_means_with_mean_wavelengths(rows: int, lines: int):
    values = np.random.default_rng(rows).uniform(0, 4000, (BANDS, lines, SAMPLES)).astype(np.float32)
    pipeline = Pipeline(RAW, [MaskSaturated(), BinBands(rows)])
    out = pipeline(values)
    groups = [slice(first, first + rows) for first in range(0, BANDS, rows)]
    np.testing.assert_allclose(out, [values[group].mean(axis=0) for group in groups], rtol=1e-5)
    assert pipeline.output.wavelength_nm is not None
    assert RAW.wavelength_nm is not None
    np.testing.assert_allclose(pipeline.output.wavelength_nm, [RAW.wavelength_nm[group].mean() for group in groups])
    assert pipeline.output.bands == len(out)


def test_a_line_alone_is_processed_as_within_its_shard():
    dark, white = reference(100), reference(1100)
    raw = np.random.default_rng(3).integers(0, 4096, (BANDS, 9, SAMPLES), np.uint16)
    pipeline = Pipeline(RAW, [MaskSaturated(), SubtractDark(dark), Reflectance(white, dark), BinBands(3)])
    whole = pipeline(raw)
    for line in range(9):
        np.testing.assert_array_equal(pipeline(raw[:, line]), whole[:, line])


@pytest.mark.parametrize(
    ("steps", "why"),
    [
        ([SubtractDark(reference(1, exposure_s=0.03))], "exposure 30 ms instead of 20 ms"),
        ([SubtractDark(reference(1, gain_db=0.0))], "gain 0 dB instead of 3 dB"),
        ([SubtractDark(reference(1, roi={"bands": BANDS, "samples": SAMPLES, "band_offset": 4}))], "region"),
        ([BinBands(2), SubtractDark(reference(1))], "11x7 bands and samples, not 6x7"),
        ([Reflectance(reference(2), reference(1, exposure_s=1.0))], "no dark reference for"),
        ([Reflectance(reference(2), reference(1), tile=99)], "tile"),
        ([Reflectance(reference(2), reference(1)), SubtractDark(reference(1))], "applies to counts"),
        ([Reflectance(reference(2), reference(1)), MaskSaturated()], "only raw counts"),
        ([BinBands(12)], "there are 11"),
        ([BinBands(0)], "cannot be binned"),
    ],
)
def test_what_does_not_fit_is_refused_with_the_reason(steps: list, why: str):
    with pytest.raises(CalibrationError, match=why):
        Pipeline(RAW, steps)


def test_unknown_conditions_are_not_held_against_a_reference():
    imported = replace(RAW, conditions=Conditions())
    assert Pipeline(imported, [SubtractDark(reference(1))]).output.long_name == "dark-corrected counts"


def test_provenance_names_steps_and_sources():
    dark = reference(100, "dark.zarr")
    described = Pipeline(RAW, [MaskSaturated(), SubtractDark(dark), BinBands(5)]).describe()
    assert described == [
        {"step": "mask saturated", "level": None},
        {"step": "subtract dark", "source": "dark.zarr", "lines": 10, "exposure_s": 0.02},
        {"step": "bin bands", "rows": 5},
    ]
