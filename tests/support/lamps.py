"""A mercury-argon lamp on an ideal sensor, from analytic truth."""

from __future__ import annotations

import numpy as np

from scanhsi.calibration.lines import hgar

BANDS = np.arange(1088.0)
TRUTH_NM = 370.79 + 0.536 * BANDS - 4e-6 * BANDS**2
"""The polynomial of the paper, per band instead of per channel of five."""

READ_VARIANCE = 170.0


def lamp(shift: np.ndarray | float = 0.0, fwhm_nm: float = 2.9, peak: float = 3000.0) -> np.ndarray:
    """Electrons of the lines, (band,) or (band, sample) for shifts of (sample,) or (band, sample) from the reference band."""
    lines = hgar()
    shape = np.broadcast_shapes(np.shape(shift), (len(BANDS), 1))
    total = np.zeros(shape)
    for nm, height, species in zip(lines.wavelength_nm, lines.intensity, lines.species, strict=True):
        if not TRUTH_NM[0] < nm < TRUTH_NM[-1]:
            continue
        band = np.interp(nm, TRUTH_NM, BANDS)
        there = band + (np.asarray(shift)[round(band)] if np.ndim(shift) == 2 else shift)
        width = fwhm_nm / (0.536 - 8e-6 * band)
        share = height / (12_000 if species == "Hg I" else 25_000)
        total += share * peak * np.exp(-4 * np.log(2) * ((BANDS[:, None] - there) / width) ** 2)
    return total if np.ndim(shift) else total[:, 0]


def noisy(electrons: np.ndarray, seed: int, averaged: int = 1) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.normal(electrons + 5, np.sqrt((electrons + READ_VARIANCE) / averaged))
