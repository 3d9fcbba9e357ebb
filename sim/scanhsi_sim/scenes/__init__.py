"""What the simulated camera looks at: scenes by name."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from scanhsi.devices.errors import ConfigError
from scanhsi_sim.effects import Setup
from scanhsi_sim.geometry import Geometry
from scanhsi_sim.lamp import hgar_rates
from scanhsi_sim.scenes import targets
from scanhsi_sim.scenes.base import Image, Scene
from scanhsi_sim.scenes.hand import hand_scene
from scanhsi_sim.scenes.spectral import even, tile
from scanhsi_sim.scenes.testpattern import TestPattern

__all__ = ["SCENES", "Geometry", "Image", "Scene", "load_scene"]


def _target(target: targets.Target) -> Callable[[Setup], Scene]:
    return partial(targets.target_scene, target=target)


SCENES: dict[str, Callable[[Setup], Scene]] = {
    "amsler": _target(targets.amsler),
    "dark": partial(tile, reflectance=0.0),
    "hand": hand_scene,
    "hgar": lambda setup: even(setup, hgar_rates(setup)),
    "slanted-edge": _target(targets.slanted_edge),
    "slanted-lines": _target(targets.slanted_lines),
    "testpattern": lambda setup: TestPattern(setup.geometry.sensor),
    "white": partial(tile, reflectance=0.99),
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
