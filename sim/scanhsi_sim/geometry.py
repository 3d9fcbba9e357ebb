"""Where mirror steps and samples look at."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Geometry:
    """How the instrument sees the object plane.

    Attributes:
        sensor: (bands, samples) of the sensor.
        pixel_mm: Size of a pixel in the object plane, along the slit, straight ahead (0.155 mm: a 12 mm lens at 350 mm).
        distance_mm: Distance r from the mirror to the object plane along the view at the normal step.
        normal_step: Mirror step, with fractions, at which the view is straight ahead.
        steps_per_revolution: Of the mirror.
        tilt_rad: Of the object plane about the slit's direction: the end at negative y is farther away.
    """

    sensor: tuple[int, int] = (1088, 2048)
    pixel_mm: float = 0.155
    distance_mm: float = 350.0
    normal_step: float = 0
    steps_per_revolution: int = 19_200
    tilt_rad: float = 0.0

    def view_rad(self, step: float) -> float:
        """Optical angle gamma = 2 dtheta k' of a mirror step, from straight ahead."""
        return 4 * math.pi * (step - self.normal_step) / self.steps_per_revolution

    def magnified(self, step: float) -> float:
        """Size of a pixel at a step, over that straight ahead: 1 / cos(gamma) without tilt (eq 9)."""
        return math.cos(self.tilt_rad) / math.cos(self.view_rad(step) + self.tilt_rad)

    def stretched(self, step: float) -> float:
        """Way of the view over the object plane along the scan, over that straight ahead: 1 / cos(gamma)^2 without tilt."""
        return math.cos(self.tilt_rad) / math.cos(self.view_rad(step) + self.tilt_rad) ** 2

    def y_mm(self, step: float) -> float:
        """Place of a line in the object plane, y = -r tan(gamma): eqs 8 and 12 of the paper; sine rule where it is tilted."""
        gamma = self.view_rad(step)
        return -self.distance_mm * math.sin(gamma) / math.cos(gamma + self.tilt_rad)

    def x_mm(self, step: float, samples: NDArray[np.float32]) -> NDArray[np.float32]:
        """Places of samples along a line, x = (sample - x0) dx sec(gamma): eq 9, with the principal column x0."""
        centre = (self.sensor[1] - 1) / 2
        return (samples - np.float32(centre)) * np.float32(self.pixel_mm * self.magnified(step))
