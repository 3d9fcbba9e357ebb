"""scipy's filters with types."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

Floats = NDArray[np.floating[Any]]


def blur(image: Floats, sigma: float | tuple[float, ...], *, reach: float = 3.0) -> Floats:
    """Gaussian blur with this standard deviation, in pixels (of each axis, or of all), cut off at so many of them."""
    return np.asarray(ndimage.gaussian_filter(image, sigma, mode="nearest", truncate=reach), image.dtype)


def distance(mask: NDArray[np.bool_]) -> Floats:
    """Distance of each pixel to the nearest False one, in pixels."""
    return np.asarray(ndimage.distance_transform_edt(mask), np.float32)
