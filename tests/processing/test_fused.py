"""Steps that became one sum against the same steps one by one, in float64."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scanhsi.calibration.conditions import Conditions
from scanhsi.calibration.keystone import Keystone
from scanhsi.calibration.reference import Reference
from scanhsi.calibration.result import Provenance
from scanhsi.calibration.smile import Smile
from scanhsi.processing import (
    BinBands,
    CorrectKeystone,
    CorrectSmile,
    MaskSaturated,
    Pipeline,
    Reflectance,
    Signal,
    Step,
    SubtractDark,
)
from scanhsi.processing.kernel import Kernel

NOTHING = np.zeros(0)


def signal(bands: int, samples: int) -> Signal:
    return Signal(
        bands=bands,
        samples=samples,
        dtype=np.dtype(np.uint16),
        units="counts",
        long_name="raw camera counts",
        saturation=4095,
        wavelength_nm=None,
        conditions=Conditions(),
    )


def smile(bands: int, samples: int, slant: float, bend: float, across: float) -> Smile:
    return Smile(
        bands=bands,
        samples=samples,
        reference_sample=(samples - 1) / 2,
        coefficients=np.array([[slant, bend], [across, across / 2]]),
        coefficients_sigma=np.zeros((2, 2)),
        residual_bands=0.0,
        line_nm=NOTHING,
        block=NOTHING,
        line_band=NOTHING[None],
        line_fwhm_nm=NOTHING[None],
        provenance=Provenance(),
    )


def keystone(bands: int, samples: int) -> Keystone:
    return Keystone(
        bands=bands,
        samples=samples,
        coefficients=np.array([[0.4, 0.8], [0.0, 0.1]]),
        coefficients_sigma=np.zeros((2, 2)),
        residual_samples=0.0,
        band=NOTHING,
        sample=NOTHING,
        moved=NOTHING[None],
        provenance=Provenance(),
    )


def reference(rng: np.random.Generator, level: float, bands: int, samples: int, *, holes: int) -> Reference:
    mean = (level + rng.uniform(0, level / 4, (bands, samples))).astype(np.float32)
    for _ in range(holes):
        mean[rng.integers(bands), rng.integers(samples)] = np.nan
    return Reference("ref.zarr", mean, 10, Conditions())


def naive(steps: list[Step], start: Signal, lines: np.ndarray) -> np.ndarray:
    """What the steps say they do, one value at a time where it is not arithmetic, in float64."""
    values = lines.astype(np.float64)
    for step in steps:
        if isinstance(step, MaskSaturated):
            values[lines >= (step.level or start.saturation)] = np.nan
        elif isinstance(step, SubtractDark):
            values = values - step.dark.mean[:, None, :]
        elif isinstance(step, Reflectance):
            light = step.white.mean.astype(np.float64) - step.dark.mean
            values = values * np.where(light > 0, step.tile / light, np.nan)[:, None, :]
        elif isinstance(step, CorrectSmile):
            values = moved(step.smile.shift(), values)
        elif isinstance(step, BinBands):
            cuts = range(0, len(values), step.rows)
            values = np.stack([values[first : first + step.rows].mean(axis=0) for first in cuts])
        elif isinstance(step, CorrectKeystone):
            values = moved(step.keystone.shift().T, values.transpose(2, 1, 0)).transpose(2, 1, 0)
    return values


def moved(shift: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Lagrange's cubic at each pixel; reflectances keep their value."""
    size = len(values)
    out = np.full_like(values, np.nan)
    for band, sample in np.ndindex(shift.shape):
        place = band + shift[band, sample]
        if not -1e-6 <= place <= size - 1 + 1e-6:
            continue
        base = min(max(int(np.floor(place)), 0), size - 2)
        nodes = [base, base + 1] if base in (0, size - 2) else [base - 1, base, base + 1, base + 2]
        share = min(max(place - base, 0), 1)
        share = 0 if share < 1e-6 else share
        total = np.zeros(values.shape[1])
        for node in nodes:
            weight = np.prod([(base + share - other) / (node - other) for other in nodes if other != node])
            if weight:
                total = total + weight * values[node, :, sample]
        out[band, :, sample] = total
    return out


def chain(rng: np.random.Generator, bands: int, samples: int, rows: int, bend: float) -> list[Step]:
    dark = reference(rng, 60, bands, samples, holes=1)
    white = reference(rng, 3000, bands, samples, holes=1)
    bent = smile(bands, samples, bend / 2, -bend, bend / 3)
    return [MaskSaturated(), SubtractDark(dark), Reflectance(white, dark, 0.99), CorrectSmile(bent), BinBands(rows)]


@given(
    seed=st.integers(0, 10_000),
    bands=st.integers(6, 130),
    samples=st.integers(2, 150),
    rows=st.integers(1, 6),
    bend=st.floats(-6, 6),
    count=st.integers(1, 5),
)
@settings(max_examples=60, deadline=None)
def test_the_chain_is_what_float64_says_and_nan_where_it_says(seed, bands, samples, rows, bend, count):
    rng = np.random.default_rng(seed)
    steps = chain(rng, bands, samples, rows, bend)[: rng.integers(2, 6)]
    raw = rng.integers(0, 4000, (bands, 3, samples)).astype(np.uint16)
    for _ in range(count):
        raw[rng.integers(bands), rng.integers(3), rng.integers(samples)] = 4095
    start = signal(bands, samples)
    out, expected = Pipeline(start, steps)(raw), naive(steps, start, raw)
    np.testing.assert_array_equal(np.isnan(out), np.isnan(expected))
    scale = 4000 if len(steps) == 2 else 4000 / 2900
    np.testing.assert_allclose(out, expected, rtol=1e-5, atol=2e-6 * scale)


def test_counts_and_floats_with_nan_are_the_same():
    rng = np.random.default_rng(1)
    steps = chain(rng, 64, 100, 5, 1.0)
    raw = rng.integers(0, 4096, (64, 4, 100)).astype(np.uint16)
    raw[30:34, 1, 20:40] = 4095
    out = Pipeline(signal(64, 100), steps)(raw)
    masked = np.where(raw >= 4095, np.nan, raw).astype(np.float32)
    unmasked = replace(signal(64, 100), saturation=None)
    np.testing.assert_array_equal(Pipeline(unmasked, steps[1:])(masked), out)
    assert np.isnan(out[6, 1, 20:40]).all()


def test_all_saturated_is_all_nan_and_the_next_line_is_not_touched():
    steps = chain(np.random.default_rng(2), 40, 70, 5, 0.0)
    raw = np.full((40, 3, 70), 1000, np.uint16)
    raw[:, 1] = 4095
    out = Pipeline(signal(40, 70), steps)(raw)
    assert np.isnan(out[:, 1]).all()
    assert np.isfinite(out[:, [0, 2]]).mean() > 0.98


def test_lines_are_the_same_bit_for_bit_whichever_go_with_them():
    rng = np.random.default_rng(3)
    steps = chain(rng, 128, 200, 5, 2.0)
    pipeline = Pipeline(signal(128, 200), steps)
    raw = rng.integers(0, 4096, (128, 7, 200)).astype(np.uint16)
    whole = pipeline(raw)
    by_line = np.asfortranarray(raw)
    for line in range(7):
        np.testing.assert_array_equal(pipeline(by_line[:, line]), whole[:, line])
    np.testing.assert_array_equal(pipeline(raw[:, 2:5]), whole[:, 2:5])


def test_steps_that_are_no_sums_along_the_bands_stay_between_those_that_are():
    class Twice:
        name = "twice"

        def bind(self, signal):
            return replace(signal, dtype=np.dtype(np.float32)), lambda lines: 2 * lines

        def describe(self):
            return {}

    rng = np.random.default_rng(4)
    first = chain(rng, 40, 60, 4, 1.0)
    steps = [*first[:4], CorrectKeystone(keystone(40, 60)), Twice(), first[4]]
    raw = rng.integers(0, 4096, (40, 3, 60)).astype(np.uint16)
    start = signal(40, 60)
    expected = naive(steps, start, raw) * 2
    out = Pipeline(start, steps)(raw)
    np.testing.assert_array_equal(np.isnan(out), np.isnan(expected))
    np.testing.assert_allclose(out, expected, rtol=2e-5, atol=1e-5)


@pytest.mark.parametrize("bend", [0.0, 9.0])
def test_the_whole_chain_is_one_pass(bend):
    pipeline = Pipeline(signal(100, 130), chain(np.random.default_rng(5), 100, 130, 5, bend))
    assert [type(function) for function in pipeline.functions] == [Kernel]
