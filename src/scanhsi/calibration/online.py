"""What the picture shows that is written beside a cube while it is scanned."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanhsi.calibration.colour import srgb_matrix
from scanhsi.cube.quicklook import QuicklookSpec


def online_quicklook(bands: int, wavelength_nm: NDArray[np.float64] | None) -> QuicklookSpec:
    """Colours where the bands have visible wavelengths; else thirds of the bands. In counts: a flat spectrum keeps its value.

    Args:
        bands: Of the camera.
        wavelength_nm: (bands,) centres, where calibrated.
    """
    if wavelength_nm is not None:
        try:
            weights = srgb_matrix(wavelength_nm).T
        except ValueError:
            pass
        else:
            return QuicklookSpec(
                weights, note="linear sRGB (CIE 1931, D65) of raw counts; not white-balanced, no gamma"
            )
    weights = np.zeros((3, bands))
    for channel, third in enumerate(np.array_split(np.arange(bands), 3)[::-1]):
        weights[channel, third] = 1 / max(1, len(third))
    return QuicklookSpec(weights, note="false colour: thirds of the bands, the last one red")
