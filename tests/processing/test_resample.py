import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scanhsi.processing.resample import Mover

BANDS, LINES, SAMPLES = 60, 3, 40
BAND = np.arange(BANDS)[:, None, None]
SAMPLE = np.arange(SAMPLES)[None, None, :]


def smooth(band, sample):
    return 100 + 40 * np.sin(band / 6) * np.cos(sample / 8) + 0 * np.zeros((1, LINES, 1))


def shifts(seed: int, largest: float) -> np.ndarray:
    rng = np.random.default_rng(seed)
    t, u = np.linspace(-1, 1, SAMPLES)[None, :], np.linspace(-1, 1, BANDS)[:, None]
    a, b, c = rng.uniform(-largest, largest, 3)
    return a * t**2 + b * t + 0.2 * c * u * t


@pytest.mark.parametrize(("kind", "error"), [("cubic", 0.02), ("linear", 0.3)])
@pytest.mark.parametrize("axis", ["band", "sample"])
def test_values_between_pixels(kind, error, axis):
    shift = shifts(1, 1.5)
    moved = Mover(shift, axis, kind=kind)(smooth(BAND, SAMPLE).astype(np.float32))
    at = shift[:, None, :]
    truth = smooth(BAND + at, SAMPLE) if axis == "band" else smooth(BAND, SAMPLE + at)
    inner = np.isfinite(moved)
    assert inner.mean() > 0.85
    assert np.abs(moved - truth)[inner].max() < (error if kind == "linear" else 0.2)
    assert np.sqrt(np.mean((moved - truth)[inner] ** 2)) < error


@given(seed=st.integers(0, 1000), largest=st.floats(0, 8), axis=st.sampled_from(["band", "sample"]))
@settings(max_examples=60, deadline=None)
def test_against_one_pixel_at_a_time(seed: int, largest: float, axis):
    """The weights, taps and runs come to the same as Lagrange's formula at each pixel."""
    shift = shifts(seed, largest)
    rng = np.random.default_rng(seed)
    lines = rng.uniform(0, 100, (BANDS, LINES, SAMPLES)).astype(np.float32)
    moved = Mover(shift, axis)(lines)
    for _ in range(25):
        b, line, s = rng.integers(BANDS), rng.integers(LINES), rng.integers(SAMPLES)
        row = lines[:, line, s] if axis == "band" else lines[b, line, :]
        place = (b if axis == "band" else s) + shift[b, s]
        if not -1e-6 <= place <= len(row) - 1 + 1e-6:
            assert np.isnan(moved[b, line, s])
            continue
        base = min(max(int(np.floor(place)), 0), len(row) - 2)
        nodes = [base, base + 1] if base in (0, len(row) - 2) else [base - 1, base, base + 1, base + 2]
        value = 0.0
        for node in nodes:
            others = [other for other in nodes if other != node]
            value += row[node] * np.prod([(place - other) / (node - other) for other in others])
        assert moved[b, line, s] == pytest.approx(value, rel=1e-4, abs=1e-3)


def test_no_shift_is_the_same_numbers_and_no_neighbour_is_spoilt():
    lines = np.random.default_rng(2).uniform(0, 100, (BANDS, LINES, SAMPLES)).astype(np.float32)
    lines[20, 1, 7] = np.nan
    moved = Mover(np.zeros((BANDS, SAMPLES)), "band")(lines)
    np.testing.assert_array_equal(moved, lines)


@pytest.mark.parametrize(("kind", "spoilt"), [("cubic", [18, 19, 20, 21]), ("linear", [19, 20])])
def test_an_unknown_pixel_spoils_only_what_takes_it_in(kind, spoilt):
    lines = np.ones((BANDS, LINES, SAMPLES), np.float32)
    lines[20, 1, 7] = np.nan
    moved = Mover(np.full((BANDS, SAMPLES), 0.4), "band", kind=kind)(lines)
    beyond = np.zeros_like(moved, bool)
    beyond[BANDS - 1] = True  # the light fell beside the sensor
    assert np.argwhere(np.isnan(moved) & ~beyond).tolist() == [[band, 1, 7] for band in spoilt]
    known = np.isfinite(moved)
    np.testing.assert_allclose(moved[known], 1, rtol=1e-6)
    assert np.isnan(moved[BANDS - 1]).all()


@pytest.mark.parametrize("axis", ["band", "sample"])
def test_counts_keep_their_sum(axis):
    stretch = 0.01 * (np.arange(BANDS)[:, None] - 30) if axis == "band" else 0.01 * (np.arange(SAMPLES)[None, :] - 20)
    shift = np.broadcast_to(stretch, (BANDS, SAMPLES))
    peak = np.exp(-(((BAND - 30) / 4) ** 2) - ((SAMPLE - 20) / 4) ** 2) * np.ones((1, LINES, 1))
    kept = Mover(shift, axis, conserve=True)(peak.astype(np.float32))
    assert np.nansum(kept) == pytest.approx(peak.sum(), rel=1e-3)
    values = Mover(shift, axis)(peak.astype(np.float32))
    assert np.nansum(values) == pytest.approx(peak.sum() / 1.01, rel=1e-3)
