"""What the simulated camera looks at: scenes by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

from scanhsi.devices.errors import ConfigError
from scanhsi_sim.effects import Setup
from scanhsi_sim.geometry import Geometry
from scanhsi_sim.lamp import hgar_rates
from scanhsi_sim.scenes import targets
from scanhsi_sim.scenes.base import Image, Scene
from scanhsi_sim.scenes.hand import hand_scene
from scanhsi_sim.scenes.spectral import even, tile
from scanhsi_sim.scenes.surfaces import colour_checker, wavelength_tile
from scanhsi_sim.scenes.testpattern import TestPattern
from scanhsi_sim.scenes.usaf import usaf

__all__ = ["COLD_LAMP", "SCENES", "TILES", "Geometry", "Image", "Scene", "load_scene"]


def _target(target: targets.Target) -> Callable[[Setup], Scene]:
    return partial(targets.target_scene, target=target)


TILES = {"white": 0.99, **{f"tile-{percent}": percent / 100 for percent in (75, 50, 25, 10, 5, 2)}}
"""Reflectances of the tiles that are the same at all wavelengths."""

COLD_LAMP = "cold-lamp"
"""The white tile in the light of a lamp that is switched on when the camera connects, or when it is shown."""


def _cold_lamp(setup: Setup) -> Scene:
    lamp = setup.lamp.model_copy(update={"on_before_s": 0.0})
    return tile(replace(setup, lamp=lamp), TILES["white"])


SCENES: dict[str, Callable[[Setup], Scene]] = {
    "amsler": _target(targets.amsler),
    COLD_LAMP: _cold_lamp,
    "colour-checker": colour_checker,
    "dark": partial(tile, reflectance=0.0),
    "hand": hand_scene,
    "hgar": lambda setup: even(setup, hgar_rates(setup)),
    "slanted-edge": _target(targets.slanted_edge),
    "slanted-lines": _target(targets.slanted_lines),
    "testpattern": lambda setup: TestPattern(setup.geometry.sensor),
    "usaf": _target(usaf),
    "wavelength-tile": wavelength_tile,
    **{name: partial(tile, reflectance=reflectance) for name, reflectance in TILES.items()},
}


def load_scene(name: str, geometry: Geometry | None = None, *, seed: int = 0, setup: Setup | None = None) -> Scene:
    """Build a scene.

    Args:
        name: One of `SCENES`.
        geometry: Sensor shape, pixel pitch, distance and normal step; those of the paper's instrument by default.
        seed: Of everything that is random in it, sensor noise included. The test pattern has nothing random.
        setup: Geometry, seed and all effects, instead of the two.

    Raises:
        ConfigError: No such scene.
    """
    if name not in SCENES:
        raise ConfigError(f"there is no simulated scene {name!r}; there are: {', '.join(SCENES)}.")
    return SCENES[name](setup or Setup(geometry or Geometry(), seed))
