"""The back of a right hand on dark cloth beside a white strip: the demonstration of the paper (figure 14), invented here.

Shape, relief, vessels, pigment and texture are drawn once as maps of the object plane; a line is read out of them by the geometry
of the mirror. Fingers point to +y, which lower mirror steps see.
"""

import numpy as np
from numpy.typing import NDArray

from scanhsi_sim import skin
from scanhsi_sim.effects import Setup
from scanhsi_sim.filters import blur, distance
from scanhsi_sim.optics import reflected, wavelengths
from scanhsi_sim.scenes.anatomy import FINGERS, FOREARM, METACARPALS, VEINS
from scanhsi_sim.scenes.base import Geometry
from scanhsi_sim.scenes.shapes import (
    PITCH_MM,
    X_MM,
    Y_MM,
    Floats,
    Grid,
    Joint,
    capsule,
    chain,
    facing,
    merge,
    noise,
    spot,
    stroke,
)
from scanhsi_sim.scenes.spectral import SpectralScene

WHITE_STRIP_MM = (82.0, 90.0)
"""The white strip lies along the scan: every line sees it."""

CLOTH, WHITE, PALE, RED, TANNED, VEIN, NAIL, GLOSS = range(8)
_KINDS = 8


def hand_scene(setup: Setup) -> SpectralScene:
    """The scene; the seed changes the texture of skin and cloth and the sensor's noise."""
    maps = HandMaps(setup.geometry, setup.seed)
    return SpectralScene(setup, reflected(spectra(wavelengths(setup)), setup), maps)


def spectra(wavelength: NDArray[np.float64]) -> NDArray[np.float64]:
    """Reflectances (bands, kinds), in the order CLOTH ... GLOSS, at wavelengths in nm."""
    pale = skin.skin(wavelength, blood=0.011, melanin=0.09, saturation=0.75)
    # Dyes hardly absorb in the near infrared: dark cloth is less dark there.
    cloth = 0.022 + 0.01 * np.exp(-(((wavelength - 455) / 40) ** 2)) + 0.10 / (1 + np.exp(-(wavelength - 790) / 28))
    kinds = [
        cloth,
        np.full_like(wavelength, 0.99),
        pale,
        skin.skin(wavelength, blood=0.05, melanin=0.08, saturation=0.85),
        skin.skin(wavelength, blood=0.012, melanin=0.30, saturation=0.75),
        skin.over_vein(wavelength, pale),
        0.06 + 0.9 * skin.skin(wavelength, blood=0.025, melanin=0.03, saturation=0.9),
        np.full_like(wavelength, 1.0),
    ]
    return np.stack(kinds, axis=1)


class HandMaps:
    """Abundance maps, interpolated line by line."""

    def __init__(self, geometry: Geometry, seed: int) -> None:
        self._geometry = geometry
        self._maps = draw(seed)

    def line(self, step: float, sample: int, samples: int) -> Floats:
        """Abundances (kinds, samples) that the slit sees at a mirror step."""
        row = min(max((Y_MM[1] - self._geometry.y_mm(step)) / PITCH_MM, 0.0), self._maps.shape[1] - 1.001)
        upper, share = int(row), np.float32(row % 1)
        strip = self._maps[:, upper].astype(np.float32) * (1 - share) + self._maps[:, upper + 1] * share
        x = self._geometry.x_mm(step, np.arange(sample, sample + samples, dtype=np.float32))
        column = np.clip((x - X_MM[0]) / PITCH_MM, 0, strip.shape[1] - 1.001).astype(np.float32)
        left = column.astype(np.intp)
        beside = column - left
        return strip[:, left] * (1 - beside) + strip[:, left + 1] * beside


def draw(seed: int) -> NDArray[np.float16]:
    """Abundance maps of the object plane, (kinds, y, x) every 0.25 mm. Takes about two seconds and 25 MB."""
    grid = Grid.whole()
    rng = np.random.Generator(np.random.Philox(key=seed))
    inside = _silhouette(grid) > 0
    cover = blur(inside.astype(np.float32), 1.2)  # soft edge
    depth = distance(inside) * np.float32(PITCH_MM)
    vein = _veins(grid, rng) * (1 - np.exp(-depth / 3))
    light, gloss = _lighting(grid, depth, vein, rng)
    red, tanned = _pigments(grid, depth, rng)
    nails, rims = _nails(grid)
    light *= 1 - 0.3 * rims

    maps = np.zeros((_KINDS, *grid.shape), np.float32)
    flesh = cover * light * (1 - nails)
    maps[NAIL] = cover * light * nails
    maps[VEIN] = flesh * vein
    maps[RED] = flesh * (1 - vein) * red
    maps[TANNED] = flesh * (1 - vein) * tanned
    maps[PALE] = flesh - maps[VEIN] - maps[RED] - maps[TANNED]
    maps[GLOSS] = cover * gloss * (1 + 1.5 * nails)
    strip = ((grid.x > WHITE_STRIP_MM[0]) & (grid.x < WHITE_STRIP_MM[1])).astype(np.float32)
    maps[WHITE] = blur(strip, (0, 0.8)) * (1 - cover)
    maps[CLOTH] = (1 - cover - maps[WHITE]) * _cloth(grid, inside, rng)
    return maps.astype(np.float16)


def _silhouette(grid: Grid) -> Floats:
    palm = merge([chain(grid, bone) for bone in [*METACARPALS, FOREARM]], 3.5)
    fingers = np.max([chain(grid, joints) for joints in FINGERS.values()], axis=0)
    return merge([palm, fingers], 1.6)


def _veins(grid: Grid, rng: np.random.Generator) -> Floats:
    """Share of the light that met a vein, 0 to 1."""
    total = np.zeros(grid.shape, np.float32)
    for points, radius in VEINS:
        window, line = stroke(grid, points, 1.15 * radius)
        np.maximum(total[window], min(1.0, 0.45 + 0.4 * radius) * line, out=total[window])
    covered = np.clip(0.8 + 0.22 * noise(grid.shape, 16.0, rng), 0.35, 1)  # here and there by more tissue
    return blur(total, 0.5 / PITCH_MM) * covered  # and light spreads in the skin above


def _lighting(grid: Grid, depth: Floats, vein: Floats, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Brightness of the relief under a lamp at the upper left, and its gloss."""
    rounded = np.minimum(depth, 11)
    height = np.sqrt(rounded * (22 - rounded))  # fingers are round, the back of the hand is flat
    height = blur(height, 1.0 / PITCH_MM) + 0.5 * blur(vein, 1.5)
    for name in ("index", "middle", "ring", "little"):
        x, y, _ = FINGERS[name][0]
        spot(height, grid, (x, y - 3), 8.5, 2.2)
        tendon = np.clip(capsule(grid, (x, y - 4, 3.0), (x / 4, -75, 2.4)), 0, 3) / 3
        height += 0.55 * tendon**2 * np.clip((grid.y + 70) / 60, 0, 1)
    height += 0.05 * noise(grid.shape, 1.0, rng) + 0.12 * noise(grid.shape, 4.0, rng)
    slope_x = np.asarray(np.gradient(height, PITCH_MM, axis=1), np.float32)
    slope_y = np.asarray(np.gradient(height, -PITCH_MM, axis=0), np.float32)
    light = 0.25 + 0.75 * facing(slope_x, slope_y, (-0.25, 0.3, 0.92)) - 0.30 * _creases(grid, rng)
    gloss = 0.035 * facing(slope_x, slope_y, (-0.12, 0.15, 0.98)) ** 60
    return np.clip(light, 0.05, 1).astype(np.float32), gloss


def _creases(grid: Grid, rng: np.random.Generator) -> Floats:
    """Folds across the finger joints and the knuckles, 0 to 1."""
    wobble = 0.7 * noise(grid.shape, 5.0, rng)
    total = np.clip(noise(grid.shape, 0.7, rng) - 0.9, 0, 2) * np.float32(0.16)
    for name, joints in FINGERS.items():
        for place, folds, reach in ((0, 3, 0.55), (1, 6, 0.95), (2, 4, 0.95)):
            if (name, place) == ("thumb", 0):
                continue  # the root of the thumb lies deep in the hand
            x, y, radius = joints[place]
            window, here = grid.near(x, y, 2 * radius)
            forward, sideways = _along(here, joints[place], joints[place + 1], (x, y))
            fade = np.exp(-((sideways / (radius * reach)) ** 4))
            for fold in range(folds):
                where = (fold - (folds - 1) / 2) * 1.7
                bow = where * (1 + 0.18 * (sideways / radius) ** 2) + wobble[window]
                strength = 0.85 - 0.07 * abs(where)
                total[window] += strength * fade * np.exp(-(((forward - bow) / 0.42) ** 2))
    return np.clip(total, 0, 1)


def _along(grid: Grid, start: Joint, end: Joint, origin: tuple[float, float]) -> tuple[Floats, Floats]:
    """Coordinates from `origin` along the bone from start to end, and across it, in mm."""
    length = float(np.hypot(end[0] - start[0], end[1] - start[1]))
    dx, dy = (end[0] - start[0]) / length, (end[1] - start[1]) / length
    x, y = grid.x - np.float32(origin[0]), grid.y - np.float32(origin[1])
    return x * dx + y * dy, x * dy - y * dx


def _pigments(grid: Grid, depth: Floats, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Shares of redder and of browner skin."""
    red = 0.16 + 0.05 * noise(grid.shape, 9.0, rng) + 0.035 * noise(grid.shape, 2.0, rng) + 0.12 * np.exp(-depth / 2.5)
    for joints in FINGERS.values():
        for (x, y, _), amount, size in zip(joints, (0.16, 0.22, 0.16, 0.42), (9, 7, 6, 9), strict=True):
            spot(red, grid, (x, y), size, amount)
    tanned = 0.24 + 0.05 * noise(grid.shape, 14.0, rng) + 0.03 * noise(grid.shape, 1.5, rng)
    tanned += 0.10 * np.clip((-grid.y - 60) / 60, 0, 1)
    for _ in range(34):
        place = rng.uniform(-45, 40), rng.uniform(-140, 30)
        spot(tanned, grid, place, rng.uniform(0.7, 1.5), rng.uniform(0.15, 0.5))
    red = np.clip(red, 0, 0.75)
    return red, np.clip(tanned, 0, 0.7) * (1 - red)


def _nails(grid: Grid) -> tuple[Floats, Floats]:
    """Nails and the grooves around them, 0 to 1."""
    nails, rims = np.zeros(grid.shape, np.float32), np.zeros(grid.shape, np.float32)
    for joints in FINGERS.values():
        x, y, radius = joints[3]
        window, here = grid.near(x, y, 2 * radius)
        forward, sideways = _along(here, joints[2], joints[3], (x, y))
        rounded = ((forward / radius + 0.07) / 1.02) ** 4 + (sideways / radius / 0.74) ** 4
        within = (1 - rounded**0.25) * radius * 0.8  # mm inside a rounded square
        nails[window] = np.clip(within / 0.5 + 0.5, 0, 1)
        rims[window] = np.exp(-((within / 0.4) ** 2))
    return nails, rims


def _cloth(grid: Grid, inside: NDArray[np.bool_], rng: np.random.Generator) -> Floats:
    """Brightness of woven cloth in the shadow of the hand."""
    weave = 0.10 * np.sin(2 * np.pi * grid.x / 1.3) * np.sin(2 * np.pi * grid.y / 1.3)
    folds = 0.10 * noise(grid.shape, 45.0, rng) + 0.05 * noise(grid.shape, 0.6, rng)
    shadow = blur(inside.astype(np.float32), 4 / PITCH_MM)
    shadow = np.roll(shadow, (round(5 / PITCH_MM), round(4 / PITCH_MM)), (0, 1))
    return np.clip((1 + weave + folds) * (1 - 0.65 * shadow), 0.05, 2)
