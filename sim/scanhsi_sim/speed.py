"""How fast scenes are rendered: ``python -m scanhsi_sim.speed [SCENE ...]`` prints ms of CPU time a line with all effects on.

One thread, frames of 1088 x 1200 at 12 bit, the optics, sensor and lamp of the instrument ``characterise``. A scan at 49.5
lines/s leaves 20.2 ms a line.
"""

from __future__ import annotations

import statistics
import sys
import time

from scanhsi_sim.effects import LampOptions, OpticsOptions, SensorOptions, Setup
from scanhsi_sim.geometry import Geometry
from scanhsi_sim.scenes import SCENES, load_scene

SETUP = Setup(
    Geometry(pixel_mm=0.1, distance_mm=348.73, normal_step=7.3),
    seed=1,
    sensor=SensorOptions(
        full_scale_e=14_500,
        dsnu_e=4,
        dark_spread=0.15,
        hot_per_million=100,
        hot_e_per_s=(1000, 5500),
        hot_nonlinear=0.2,
    ),
    optics=OpticsOptions(blur_px=0.8, slit_px=5.45),
    lamp=LampOptions(warm_up=0.08, on_before_s=3600, drift_per_min=-5e-5, flicker=3e-4),
)


def line_ms(name: str, *, lines: int = 41, sweeps: bool = False) -> list[float]:
    """CPU time of each of some lines, in ms.

    Args:
        name: Scene.
        lines: How many, about the middle of the target.
        sweeps: Whether the mirror moves by a step during the exposure, as in continuous scans.
    """
    scene = load_scene(name, setup=SETUP)
    times: list[float] = []
    for line in range(-1, lines):
        step = 12.0 * (line - lines // 2) + 0.37
        began = time.thread_time()
        scene.render(
            step,
            step + sweeps,
            exposure_s=0.04,
            gain_db=0.0,
            shape=(1088, 1200),
            offset=(0, 424),
            bits=12,
            index=max(line, 0),
        )
        times.append(1e3 * (time.thread_time() - began))
    return times[1:]  # the first one fills caches


def main(names: list[str]) -> int:
    """Print a table."""
    sys.stdout.write(f"{'scene':16} {'median':>8} {'slowest':>8} {'sweeping':>8}  ms a line; lines/s\n")
    for name in names or sorted(SCENES):
        still, moving = line_ms(name), statistics.median(line_ms(name, lines=15, sweeps=True))
        median = statistics.median(still)
        sys.stdout.write(f"{name:16} {median:8.1f} {max(still):8.1f} {moving:8.1f}  {1e3 / median:8.0f}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
