"""What the simulated camera looks at: scenes by name."""

from collections.abc import Callable
from typing import Any

from scanhsi.devices.errors import ConfigError
from scanhsi_sim.scenes.base import Geometry, Image, Scene
from scanhsi_sim.scenes.hand import hand_scene
from scanhsi_sim.scenes.spectral import dark_scene, white_scene
from scanhsi_sim.scenes.testpattern import TestPattern

__all__ = ["SCENES", "Geometry", "Image", "Scene", "load_scene"]

SCENES: dict[str, Callable[[Geometry, int], Any]] = {
    "dark": dark_scene,
    "hand": hand_scene,
    "testpattern": lambda geometry, seed: TestPattern(geometry.sensor),
    "white": white_scene,
}


def load_scene(name: str, geometry: Geometry | None = None, *, seed: int = 0) -> Scene:
    """Build a scene.

    Args:
        name: One of `SCENES`.
        geometry: Sensor shape, pixel pitch, distance and normal step; those of the paper's instrument by default.
        seed: Of everything that is random in it, sensor noise included. The test pattern has nothing random.

    Raises:
        ConfigError: No such scene.
    """
    if name not in SCENES:
        raise ConfigError(f"there is no simulated scene {name!r}; there are: {', '.join(SCENES)}.")
    return SCENES[name](geometry or Geometry(), seed)
