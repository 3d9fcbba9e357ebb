"""Means over the cells of an even grid, of values known at uneven places.

Between two places values change along a straight line; a cell takes the mean of that over its width. So a coarse grid averages all
that lies in a cell and the sum over the area stays, and a fine one interpolates. A value that is not known spoils the cells that
take it in, and nothing else.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_NEGLIGIBLE: Final = 1e-9


def cell_weights(places: Floats, edges: Floats) -> Floats:
    """Weights of values at places in the means over cells.

    Args:
        places: Rising, (place,).
        edges: Of the cells, rising, (cell + 1,).

    Returns:
        (cell, place), each row sums to 1; nan throughout where a cell reaches beyond the places.
    """
    width = np.diff(places)
    at = np.clip(np.searchsorted(places, edges, side="right") - 1, 0, len(places) - 2)
    share = (np.clip(edges, places[0], places[-1]) - places[at]) / width[at]
    halves = np.zeros((len(places) - 1, len(places)))  # integral of each hat over each interval
    index = np.arange(len(places) - 1)
    halves[index, index] = halves[index, index + 1] = width / 2
    before = np.vstack((np.zeros(len(places)), np.cumsum(halves, axis=0)))
    integral = before[at]
    rows = np.arange(len(edges))
    integral[rows, at] += width[at] * (share - share**2 / 2)
    integral[rows, at + 1] += width[at] * share**2 / 2
    weights = np.diff(integral, axis=0) / np.diff(edges)[:, None]
    weights[np.abs(weights) < _NEGLIGIBLE] = 0
    weights[~_within(edges, float(places[0]), float(places[-1]))] = np.nan
    return weights


def cell_means(values: NDArray[Any], edges: Floats) -> NDArray[np.float32]:
    """Means over cells of values at places 0, 1, 2 ... along the last axis.

    Args:
        values: (..., place), nan where not known.
        edges: Of the cells in places, rising, (cell + 1,).

    Returns:
        (..., cell) float32; nan where a cell takes in what is not known, or reaches beyond the places.
    """
    last = values.shape[-1] - 1
    unknown = np.isnan(values)
    some_unknown = bool(unknown.any())
    filled = np.where(unknown, np.float32(0), values) if some_unknown else values
    inside = np.clip(edges, 0, last)
    first = np.floor(inside[:-1]).astype(np.intp)
    width = np.maximum(np.diff(inside), _NEGLIGIBLE)
    means = np.zeros((*values.shape[:-1], len(edges) - 1), np.float32)
    for tap in range(int((np.ceil(inside[1:]) - first).max()) + 1):
        place = first + tap
        weight = (_hat_integral(inside[1:] - place) - _hat_integral(inside[:-1] - place)) / width
        means += weight.astype(np.float32) * filled[..., np.minimum(place, last)]
    if some_unknown:
        means[_any_between(unknown, inside)] = np.nan
    means[..., ~_within(edges, 0.0, float(last))] = np.nan
    return means


def _hat_integral(t: Floats) -> Floats:
    """Integral up to t of the hat that is 1 at 0 and falls to 0 at -1 and 1."""
    t = np.clip(t, -1, 1)
    return np.where(t < 0, (t + 1) ** 2 / 2, 1 - (1 - t) ** 2 / 2)


def _any_between(unknown: NDArray[np.bool_], edges: Floats) -> NDArray[np.bool_]:
    """Whether a cell takes in an unknown place: one between its edges, or next to them."""
    last = unknown.shape[-1] - 1
    first = np.clip(np.floor(edges[:-1] + _NEGLIGIBLE), 0, last).astype(np.intp)
    behind = np.clip(np.ceil(edges[1:] - _NEGLIGIBLE), 0, last).astype(np.intp) + 1
    counts = np.concatenate((np.zeros((*unknown.shape[:-1], 1), np.int32), np.cumsum(unknown, axis=-1)), axis=-1)
    return counts[..., behind] > counts[..., first]


def _within(edges: Floats, low: float, high: float) -> NDArray[np.bool_]:
    margin = 1e-6 * (high - low)
    return (edges[:-1] >= low - margin) & (edges[1:] <= high + margin)
