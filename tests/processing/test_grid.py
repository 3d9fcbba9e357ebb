import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scanhsi.processing.grid import cell_means, cell_weights


@given(seed=st.integers(0, 500), cells=st.integers(2, 80))
@settings(max_examples=50, deadline=None)
def test_means_of_a_broken_line_over_cells(seed: int, cells: int):
    """Against the integral of the interpolant by brute force, from far coarser to far finer than the places."""
    rng = np.random.default_rng(seed)
    places = np.cumsum(rng.uniform(0.5, 1.5, 30))
    values = rng.normal(size=30)
    edges = np.linspace(places[0], places[-1], cells + 1)
    weights = cell_weights(places, edges)
    fine = np.linspace(places[0], places[-1], cells * 400 + 1)
    fine = (fine[1:] + fine[:-1]) / 2
    truth = np.interp(fine, places, values).reshape(cells, 400).mean(axis=1)
    np.testing.assert_allclose(weights @ values, truth, atol=2e-3)
    np.testing.assert_allclose(weights.sum(axis=1), 1)


def test_both_ways_agree_on_even_places():
    rng = np.random.default_rng(1)
    values = rng.normal(size=(3, 40))
    edges = np.sort(rng.uniform(0, 39, 20))
    np.testing.assert_allclose(cell_means(values, edges), values @ cell_weights(np.arange(40.0), edges).T, atol=1e-5)


@pytest.mark.parametrize("pitch", [0.37, 1.0, 3.1])
def test_the_sum_over_the_area_stays(pitch: float):
    place = np.arange(200.0)
    values = np.exp(-(((place - 100) / 12) ** 2))
    edges = np.arange(10, 190, pitch)
    assert cell_means(values, edges).sum() * pitch == pytest.approx(values.sum(), rel=1e-3)


def test_unknown_places_spoil_only_the_cells_that_take_them_in():
    values = np.arange(20.0)
    values[10] = np.nan
    edges = np.arange(0, 19.5, 0.5)
    means = cell_means(values, edges)
    spoilt = (edges[1:] > 9) & (edges[:-1] < 11)
    np.testing.assert_array_equal(np.isnan(means), spoilt)
    np.testing.assert_allclose(means[~spoilt], ((edges[1:] + edges[:-1]) / 2)[~spoilt], rtol=1e-6)


def test_beyond_the_places_nothing_is_known():
    means = cell_means(np.ones(10), np.arange(-2.0, 12.0))
    np.testing.assert_array_equal(np.isfinite(means), [False, False, *[True] * 9, False, False])
    weights = cell_weights(np.arange(10.0), np.arange(-2.0, 12.0))
    np.testing.assert_array_equal(np.isfinite(weights).all(axis=1), np.isfinite(means))
