"""Peaks of the simulated lamp's lines, some missing and some that are none: the same for all who identify them."""

from __future__ import annotations

import numpy as np

BANDS = np.arange(1088.0)
TRUTH_NM = 370.79 + 0.536 * BANDS - 4e-6 * BANDS**2


def peaks_of(
    lines_nm: np.ndarray, seed: int, missing: float, spurious: float, scatter: float = 0.1
) -> tuple[np.ndarray, np.ndarray]:
    """Places of peaks, and the line of each, -1 for none."""
    places = np.interp(lines_nm, TRUTH_NM, BANDS)
    rng = np.random.default_rng(seed)
    kept = rng.choice(len(places), round((1 - missing) * len(places)), replace=False)
    false = round(len(kept) * spurious / (1 - spurious))
    peaks = np.concatenate([places[kept] + rng.normal(0, scatter, len(kept)), rng.uniform(0, 1087, false)])
    return peaks, np.concatenate([kept, np.full(false, -1)])
