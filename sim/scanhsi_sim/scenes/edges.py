"""Coverage of straight edges, lines and gratings, seen through a footprint: exact, so that a transfer function can be compared.

A sample sees the object plane through its own width (a box along the slit), the width of the slit (a box along the scan) and the
point spread function of the lens (a Gaussian). Across an edge of any direction these are a Gaussian and two boxes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from scanhsi_sim.effects import OpticsOptions
from scanhsi_sim.geometry import Geometry

Floats = NDArray[np.floating[Any]]

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(4)
_SHARP_MM = 1e-4  # what is narrower counts as this wide


@dataclass(frozen=True, slots=True)
class Blur:
    """Blur across an edge: a Gaussian and two boxes, in mm."""

    sigma: float
    wide: float
    narrow: float

    @property
    def reach(self) -> float:
        """Beyond this distance an edge is not seen any more."""
        return 5 * self.sigma + (self.wide + self.narrow) / 2

    def edge(self, depth: Floats) -> Floats:
        """Share of the footprint that lies in the half plane whose edge is so deep, 0 to 1."""
        if self.narrow < self.wide / 20:
            return self._boxed(depth)
        shifts = self.narrow / 2 * _NODES
        return sum(
            (weight / 2 * self._boxed(depth + s) for s, weight in zip(shifts, _WEIGHTS, strict=True)), np.zeros(1)
        )

    def _boxed(self, depth: Floats) -> Floats:
        """Gaussian and the wide box: the mean of the normal distribution function over the box."""
        if self.wide < self.sigma / 20:
            return np.asarray(ndtr(depth / self.sigma))
        if self.sigma < self.wide / 200:
            return np.clip(depth / self.wide + 0.5, 0, 1)
        return (self._integral(depth + self.wide / 2) - self._integral(depth - self.wide / 2)) / self.wide

    def _integral(self, depth: Floats) -> Floats:
        scaled = depth / self.sigma
        return self.sigma * (scaled * ndtr(scaled) + np.exp(-(scaled**2) / 2) / math.sqrt(2 * math.pi))

    def stripe(self, depth: Floats, width: float) -> Floats:
        """Share of the footprint on a stripe around depth 0."""
        return self.edge(depth + width / 2) - self.edge(depth - width / 2)

    def grating(self, depth: Floats, width: float, period: float) -> Floats:
        """The same on stripes with a period, one of them around depth 0."""
        near = depth - period * np.rint(depth / period)
        shifts = (-period, 0.0, period) if self.reach + width / 2 > period / 2 else (0.0,)
        return sum((self.stripe(near + shift, width) for shift in shifts), np.zeros(1))


@dataclass(frozen=True, slots=True)
class Footprint:
    """What a sample sees of the object plane at one line, in mm.

    Attributes:
        x, y: Its middle: (samples,) and a number.
        dx, dy: Boxes along the slit and along the scan.
        sx, sy: Standard deviations of the point spread function.
    """

    x: Floats
    y: float
    dx: float
    dy: float
    sx: float
    sy: float

    @classmethod
    def at(cls, geometry: Geometry, optics: OpticsOptions, step: float, sample: int, samples: int) -> Footprint:
        """That of a range of samples at a mirror step."""
        across, along = (
            geometry.pixel_mm * stretch for stretch in (geometry.magnified(step), geometry.stretched(step))
        )
        x = (np.arange(sample, sample + samples) - (geometry.sensor[1] - 1) / 2) * across
        blur = optics.blur_px
        return cls(x, geometry.y_mm(step), across, optics.slit_px * along, blur * across, blur * along)

    def across(self, angle_rad: float, centre: tuple[float, float] = (0.0, 0.0)) -> tuple[Floats, Blur]:
        """Depths (samples,) along a direction, angle from the slit's, from a centre; and the blur in this direction."""
        cosine, sine = math.cos(angle_rad), math.sin(angle_rad)
        boxes = sorted((abs(cosine) * self.dx, abs(sine) * self.dy))
        sigma = max(math.hypot(cosine * self.sx, sine * self.sy), _SHARP_MM)
        return (self.x - centre[0]) * cosine + (self.y - centre[1]) * sine, Blur(sigma, boxes[1], boxes[0])
