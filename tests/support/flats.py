"""Flat and dark frames of a sensor whose numbers are known."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from scanhsi.calibration.photon_transfer import FlatPair

SHAPE = (200, 250)
GAIN, READ_E, FULL_E, PRNU, DSNU_E = 0.3, 13.0, 13_500.0, 0.01, 4.0


def pairs(rng: np.random.Generator, exposures: int = 12, *, top: float = 1.3, bend: float = 0.0) -> Iterator[FlatPair]:
    """EMVA-like flats of a camera whose truth is known; counts = gain x electrons, clipped at the full well and at 12 bits."""
    response = rng.normal(1, PRNU, SHAPE)
    offset = 40 / GAIN + rng.normal(0, DSNU_E, SHAPE)

    def frames(electrons):
        light = rng.poisson(np.maximum(electrons * response, 0), (2, *SHAPE))
        noisy = np.minimum(light, FULL_E) + offset + rng.normal(0, READ_E, (2, *SHAPE))
        return np.clip(np.rint(GAIN * noisy), 0, 4095).astype(np.uint16)

    for step in np.linspace(0.05, top, exposures):
        yield FlatPair(float(step), frames(FULL_E * step * (1 - bend * step)), frames(0.0))
