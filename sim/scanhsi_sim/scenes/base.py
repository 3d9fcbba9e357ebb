"""The scene protocol, and where mirror steps and pixels look at."""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8 | np.uint16]


class Scene(Protocol):
    """Something to look at: it renders one frame at a time, on demand, in any thread."""

    def render(
        self,
        step_start: int,
        step_end: int,
        *,
        exposure_s: float,
        gain_db: float,
        shape: tuple[int, int],
        offset: tuple[int, int],
        bits: int,
        index: int,
    ) -> Image:
        """One frame, as the sensor's ADC gives it.

        Args:
            step_start: Lowest mirror step during the exposure.
            step_end: Highest mirror step; another than `step_start` means that the mirror moved, and blurs the frame.
            exposure_s: Exposure time.
            gain_db: Analogue gain.
            shape: (bands, samples) of the frame.
            offset: (band, sample) of its first pixel on the sensor.
            bits: 8 or 12.
            index: Frame number: seeds the noise.

        Returns:
            `shape`, uint8 for 8 bits, uint16 with 12 significant bits for 12.
        """
        ...


@dataclass(frozen=True)
class Geometry:
    """How the instrument sees the object plane.

    Attributes:
        sensor: (bands, samples) of the sensor.
        pixel_mm: Size of a pixel in the object plane, along the slit, straight ahead (0.155 mm: a 12 mm lens at 350 mm).
        distance_mm: Plumb distance r from the mirror to the object plane.
        normal_step: Mirror step at which the view is straight ahead.
        steps_per_revolution: Of the mirror.
    """

    sensor: tuple[int, int] = (1088, 2048)
    pixel_mm: float = 0.155
    distance_mm: float = 350.0
    normal_step: int = 0
    steps_per_revolution: int = 19_200

    def view_rad(self, step: float) -> float:
        """Optical angle gamma = 2 dtheta k' of a mirror step, from straight ahead."""
        return 4 * math.pi * (step - self.normal_step) / self.steps_per_revolution

    def y_mm(self, step: float) -> float:
        """Place of a line in the object plane, y = -r tan(gamma): eqs 8 and 12 of the paper."""
        return -self.distance_mm * math.tan(self.view_rad(step))

    def x_mm(self, step: float, samples: NDArray[np.float32]) -> NDArray[np.float32]:
        """Places of samples along a line, x = (sample - x0) dx sec(gamma): eq 9, with the principal column x0."""
        centre = (self.sensor[1] - 1) / 2
        return (samples - np.float32(centre)) * np.float32(self.pixel_mm / math.cos(self.view_rad(step)))
