"""Colours through the whole chain: a colour checker scanned, made into reflectance, and seen; against colour-science."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import scanhsi
from scanhsi import clock
from scanhsi.calibration.colour import out_of_gamut, xyz_matrix, xyz_to_linear, xyz_to_srgb
from scanhsi.calibration.reference import average
from scanhsi.calibration.view import view
from scanhsi.cube.spectra import region_spectrum
from scanhsi.instrument import load_instrument
from scanhsi.processing import BinBands, MaskSaturated, Reflectance, SubtractDark, process
from scanhsi_sim.scenes.surfaces import PATCH_PITCH_MM, patch_centre, patch_names, patches
from support import colours
from support.colours import delta_e, expected_xyz, srgb_to_xyz

SAMPLES, DISTANCE_MM, PITCH_MM = 720, 350.0, 0.155
STEP_MM = 2 * DISTANCE_MM * 2 * math.pi / 19_200
STEPS = 10  # from line to line: eight lines a row of patches
LINES = 2 * round(1.9 * PATCH_PITCH_MM / STEP_MM / STEPS) + 1
WHITE = 0.99


def truth() -> list[Any]:
    """Reflectances of the simulated patches, every nanometre."""
    nm = np.arange(380.0, 781.0)
    return [colours.spectrum(name, nm, values) for name, values in zip(patch_names(), patches(nm).T, strict=True)]


@pytest.fixture(scope="module")
def checker(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Reflectance of the simulated colour checker, in 218 channels."""
    folder = tmp_path_factory.mktemp("colours")

    async def scan(scene: str, lines: int, step: int) -> None:
        roi = {"roi.samples": SAMPLES, "roi.sample_offset": (2048 - SAMPLES) // 2}
        config = load_instrument("sensors2019", {"camera.scene": scene, "roi.bands": 1088, **roi})
        async with scanhsi.open_instrument(config) as hsi:
            start = config.geometry.normal_step - step * (lines - 1) / 2
            plan = hsi.default_plan(lines=lines, step=step, start=start, exposure_s=0.04)
            await hsi.scan(plan, folder / f"{scene}.zarr")

    for scene, lines, step in (("colour-checker", LINES, STEPS), ("white", 40, 0), ("dark", 40, 0)):
        clock.run(scan(scene, lines, step), virtual=True)
    dark, white = average(folder / "dark.zarr"), average(folder / "white.zarr")
    steps = [MaskSaturated(), SubtractDark(dark), Reflectance(white, dark, tile=WHITE), BinBands(5)]
    process(folder / "colour-checker.zarr", folder / "checker.zarr", steps)
    return folder / "checker.zarr"


def region(number: int) -> tuple[slice, slice]:
    """Lines and samples of the middle of a patch."""
    x, y = patch_centre(number)
    line, sample = (LINES - 1) / 2 - y / STEP_MM / STEPS, x / PITCH_MM + (SAMPLES - 1) / 2
    return slice(round(line) - 2, round(line) + 3), slice(round(sample) - 40, round(sample) + 41)


def test_patches_against_colour_science(checker: Path) -> None:
    cube = scanhsi.open_cube(checker, chunks=None)
    nm = cube["wavelength"].values
    assert len(nm) in (217, 218)
    differences: dict[str, float] = {}
    in_gamut: list[float] = []
    for number, spectrum in enumerate(truth()):
        xyz = region_spectrum(cube, *region(number)).mean @ xyz_matrix(nm)
        expected = expected_xyz(spectrum)
        differences[spectrum.name] = delta_e(xyz, expected)
        if not out_of_gamut(xyz_to_linear(expected)):
            in_gamut.append(delta_e(srgb_to_xyz(xyz_to_srgb(xyz)), srgb_to_xyz(colours.xyz_to_srgb(expected))))
    assert max(differences.values()) < 0.2
    assert max(in_gamut) < 0.2


def test_the_picture_has_the_same_colours(checker: Path) -> None:
    look = view(checker)
    assert np.isfinite(look.colour).all()  # a hot pixel is no hole
    assert 0.005 < look.out_of_gamut < 0.1  # cyan
    for number, spectrum in enumerate(truth()):
        lines, samples = region(number)
        shown = srgb_to_xyz(look.colour[lines, samples].reshape(-1, 3)).mean(axis=0)
        assert delta_e(shown, srgb_to_xyz(xyz_to_srgb(expected_xyz(spectrum)))) < 0.3, spectrum.name
