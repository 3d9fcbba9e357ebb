"""The scene protocol."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from scanhsi_sim.geometry import Geometry

__all__ = ["Geometry", "Image", "Scene"]

Image = NDArray[np.uint8 | np.uint16]


class Scene(Protocol):
    """Something to look at: it renders one frame at a time, on demand, in any thread."""

    def render(
        self,
        step_start: float,
        step_end: float,
        *,
        exposure_s: float,
        gain_db: float,
        shape: tuple[int, int],
        offset: tuple[int, int],
        bits: int,
        index: int,
        acquisition: int = 0,
        time_s: float = 0.0,
    ) -> Image:
        """One frame, as the sensor's ADC gives it.

        Args:
            step_start: Lowest mirror step during the exposure, with fractions where the mirror errs.
            step_end: Highest mirror step; another than `step_start` means that the mirror moved, and blurs the frame.
            exposure_s: Exposure time.
            gain_db: Analogue gain.
            shape: (bands, samples) of the frame.
            offset: (band, sample) of its first pixel on the sensor.
            bits: 8 or 12.
            index: Frame number: seeds the noise, with the two that follow.
            acquisition: How many times the camera was armed before: the noise of two acquisitions is not the same.
            time_s: Middle of the exposure, since the camera connected: for lamps that are not steady.

        Returns:
            `shape`, uint8 for 8 bits, uint16 with 12 significant bits for 12.
        """
        ...
