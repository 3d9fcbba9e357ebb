"""Test targets in the object plane: grid, bars, slanted edges and lines. Black on white (or white on black), drawn exactly."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from scanhsi_sim.effects import Setup, TargetOptions
from scanhsi_sim.optics import reflected
from scanhsi_sim.scenes.edges import Floats, Footprint
from scanhsi_sim.scenes.spectral import SpectralScene

WHITE = 0.9
"""Reflectance of the white of a target."""

Target = Callable[[Footprint, TargetOptions], Floats]
"""Share of black, (samples,), under a footprint."""


@dataclass(frozen=True, slots=True)
class _Drawn:
    setup: Setup
    target: Target

    def line(self, step: float, sample: int, samples: int) -> Floats:
        """Abundance of white."""
        setup = self.setup
        foot = Footprint.at(setup.geometry, setup.optics, step, sample, samples)
        return (1 - setup.target.contrast * self.target(foot, setup.target)).astype(np.float32)[None, :]


def target_scene(setup: Setup, target: Target) -> SpectralScene:
    """A target of white and of black."""
    rates = reflected(np.full((setup.geometry.sensor[0], 1), WHITE), setup)
    return SpectralScene(setup, rates, _Drawn(setup, target))


def amsler(foot: Footprint, options: TargetOptions) -> Floats:
    """Black lines both ways; one of each passes through the centre."""
    turn = math.radians(options.turn_deg)
    white = np.ones(1)
    for angle in (turn, turn + math.pi / 2):
        depth, blur = foot.across(angle, options.centre_mm)
        white = white * (1 - blur.grating(depth, options.grid_line_mm, options.grid_mm))
    return 1 - white


def slanted_lines(foot: Footprint, options: TargetOptions) -> Floats:
    """Parallel lines, as wide as their gaps, that rise by the tangent of their slant along the scan for each mm along the slit."""
    across = math.radians(options.lines_deg + options.turn_deg) + math.pi / 2
    depth, blur = foot.across(across, options.centre_mm)
    return blur.grating(depth, options.lines_mm / 2, options.lines_mm)


def slanted_edge(foot: Footprint, options: TargetOptions) -> Floats:
    """A white square on black, turned: two slanted edges for either axis."""
    turn = math.radians(options.edge_deg + options.turn_deg)
    white = np.ones(1)
    for angle in (turn, turn + math.pi / 2):
        depth, blur = foot.across(angle, options.centre_mm)
        white = white * blur.stripe(depth, options.edge_mm)
    return 1 - white
