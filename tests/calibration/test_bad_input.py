"""Every calibration function, given what no instrument should give it: it says what is wrong, and nothing else happens.

Each is called with input that it takes, as a check of the test, and then with the same emptied, cut too short, without light,
saturated all over, and not numbers.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from scanhsi.calibration.assign import assign_lines
from scanhsi.calibration.backlash import backlash
from scanhsi.calibration.conditions import Conditions
from scanhsi.calibration.dark import fit_dark
from scanhsi.calibration.dispersion import fit_dispersion, fit_dispersion_robustly
from scanhsi.calibration.frames import FrameStack
from scanhsi.calibration.geometry import Geometry, fit_geometry
from scanhsi.calibration.jitter import jitter
from scanhsi.calibration.keystone import fit_keystone
from scanhsi.calibration.light import light_stability
from scanhsi.calibration.lines import hgar
from scanhsi.calibration.peaks import find_peaks
from scanhsi.calibration.photon_transfer import FlatPair, photon_transfer
from scanhsi.calibration.reference import Reference
from scanhsi.calibration.repeatability import repeatability
from scanhsi.calibration.resolution import bar_contrast, edge_response
from scanhsi.calibration.result import Provenance
from scanhsi.calibration.slanted import displacements, repeated_displacements
from scanhsi.calibration.smile import calibrate_spectrograph
from scanhsi.calibration.snr import signal_to_noise
from scanhsi.calibration.tile import calibrate_with_tile, continuum_removed, find_minima
from scanhsi.calibration.usaf import columns, place_target
from scanhsi.calibration.wavelength import calibrate_with_lamp
from scanhsi.calibration.white import white_reference
from scanhsi.devices.errors import CalibrationError
from support.lamps import BANDS, TRUTH_NM, lamp, noisy

FULL = 4095.0
NOWHERE = Provenance()
LINES = hgar().merged(1.8).calibrating().within(380, 946)
PLACES = np.interp(LINES.wavelength_nm, TRUTH_NM, BANDS)
MINIMA_NM = np.array([455.0, 490, 521, 560, 603, 655, 690, 748, 802, 880])


def rng() -> np.random.Generator:
    return np.random.default_rng(1)


def tile() -> np.ndarray:
    depth = sum(0.3 * np.exp(-(((TRUTH_NM - nm) / 7) ** 2)) for nm in MINIMA_NM)
    return 0.9 * (1 - depth) + rng().normal(0, 1e-3, len(BANDS))


def flats() -> np.ndarray:
    """(exposure, flat or dark, frame, band, sample)."""
    level = np.linspace(0.1, 1.4, 14)[:, None, None, None, None] * np.array([1.0, 0.0])[:, None, None, None]
    electrons = rng().poisson(np.broadcast_to(13_000 * level, (14, 2, 2, 20, 30)))
    return np.rint(0.28 * (np.minimum(electrons, 13_000) + 100 + rng().normal(0, 13, electrons.shape)))


def edge() -> np.ndarray:
    across = np.arange(80.0) - 40 - 0.09 * np.arange(60.0)[:, None]
    return 200 + 1500 / (1 + np.exp(-across)) + rng().normal(0, 3, (60, 80))


def darks() -> np.ndarray:
    """(exposure, frame, band, sample)."""
    return 100 + 40 * np.array([0.1, 0.5, 1.0])[:, None, None, None] + rng().normal(0, 4, (3, 4, 8, 9))


def fit_darks(values: np.ndarray) -> object:
    rows = zip((0.1, 0.5, 1.0), values, strict=False)
    return fit_dark(((t, frame) for t, frames in rows for frame in frames), saturation=FULL)


def transfer(values: np.ndarray) -> object:
    pairs = [FlatPair(0.01 * (n + 1), *np.broadcast_to(one, (2, *one.shape[1:]))) for n, one in enumerate(values)]
    return photon_transfer(pairs, NOWHERE)


def white(values: np.ndarray) -> object:
    saturated = ~(values.max(axis=0, initial=0) < FULL)
    mean = values.mean(axis=0) if len(values) else np.zeros((6, 7))
    sigma = values.std(axis=0) if len(values) and np.isfinite(values).all() else np.zeros((6, 7))
    stack = FrameStack("white.zarr", mean, sigma, saturated, FULL, len(values), Conditions())
    dark = Reference("dark.zarr", np.full(mean.shape, 100, np.float32), 20, Conditions())
    return white_reference(stack, dark, NOWHERE, tile=0.99)


def bars(values: np.ndarray) -> object:
    return bar_contrast([(0.5, values)], "sample", 0.05, NOWHERE)


def slanted() -> np.ndarray:
    line, sample = np.arange(60.0)[:, None], np.arange(200.0)[None, :]
    return 1000 + 400 * np.sin(2 * np.pi * (sample / 20 + line / 9)) + rng().normal(0, 5, (60, 200))


TARGET_PLANE = Geometry(350.0, 0.0, 2 * np.pi / 19_200, 0.25, 120.0, NOWHERE)


def target() -> np.ndarray:
    """A third of a USAF target's bars, well seen."""
    picture = np.full((260, 240), 1000.0)
    for one in columns():
        if one.bar_mm > 0.6:
            x, y = one.x_mm / 0.25 + 120, -one.y_mm / 0.229 + 130
            lines, samples = np.arange(260.0)[:, None], np.arange(240.0)[None, :]
            along, beside = (samples - x) * 0.25, (lines - y) * 0.229
            along, beside = (along, beside) if one.axis == "sample" else (beside, along)
            stripes = np.abs(np.abs(along) - (np.abs(along) > one.bar_mm) * 2 * one.bar_mm) < one.bar_mm / 2
            picture[stripes & (np.abs(beside) < 2.5 * one.bar_mm)] = 60
    return picture


START = Geometry(350.0, 0.0, 2 * np.pi / 19_200, 0.1, 300.0, NOWHERE)


@dataclass(frozen=True)
class Case:
    """A calibration.

    Attributes:
        calibrate: Takes the values.
        values: Makes good ones.
        light: Whether they are light or counts, of which there may be none, or too much.
    """

    calibrate: Callable[[np.ndarray], Any]
    values: Callable[[], np.ndarray]
    light: bool = True


CASES = {
    "dark": Case(fit_darks, darks, light=False),  # a shutter that is closed gives no light
    "white": Case(white, lambda: rng().normal(3000, 20, (20, 6, 7))),
    "photon transfer": Case(transfer, flats),
    "signal to noise": Case(
        lambda v: signal_to_noise({0.1: np.moveaxis(v, 0, 1)}, NOWHERE), lambda: rng().normal(0.9, 0.01, (20, 4, 9))
    ),
    "light": Case(lambda v: light_stability(40.0 * np.arange(len(v)), v, NOWHERE), lambda: rng().normal(900, 2, 20)),
    "peaks": Case(find_peaks, lambda: noisy(lamp(), 1, 50)),
    "lamp": Case(lambda v: calibrate_with_lamp(v, NOWHERE), lambda: noisy(lamp(), 1, 50)),
    "lamp, whole slit": Case(lambda v: calibrate_spectrograph(v, NOWHERE), lambda: noisy(lamp(np.zeros(150)), 1, 50)),
    "tile": Case(lambda v: calibrate_with_tile(v, _certificate(), NOWHERE), tile),
    "minima": Case(find_minima, tile),
    "continuum": Case(continuum_removed, tile, light=False),
    "assignment": Case(lambda v: assign_lines(v, LINES), lambda: PLACES, light=False),
    "dispersion": Case(lambda v: fit_dispersion(v, TRUTH_NM[::50][: len(v)]), lambda: BANDS[::50], light=False),
    "dispersion, robust": Case(
        lambda v: fit_dispersion_robustly(v, TRUTH_NM[::50][: len(v)]), lambda: BANDS[::50], light=False
    ),
    "keystone": Case(
        lambda v: fit_keystone(v, NOWHERE),
        lambda: np.tile(1000 + 800 * np.sign(np.sin(np.arange(200) / 7)), (60, 1)) + rng().normal(0, 3, (60, 200)),
    ),
    "geometry": Case(
        lambda v: fit_geometry(v, START.y_mm(np.arange(-200, 201, 20.0)[: len(v)]), START, NOWHERE),
        lambda: np.arange(-200, 201, 20.0) + rng().normal(0, 0.3, 21),
        light=False,
    ),
    "jitter": Case(
        lambda v: jitter(np.linspace(0, 20, len(v)), v, NOWHERE), lambda: rng().normal(0, 0.2, 60), light=False
    ),
    "displacements": Case(lambda v: displacements(v, 0.18, 0.1), slanted),
    "repeated displacements": Case(lambda v: repeated_displacements([v], [v]), slanted),
    "backlash": Case(
        lambda v: backlash([v], [np.roll(v, 2, axis=0)], np.arange(len(v), dtype=float), 0.23, NOWHERE), slanted
    ),
    "repeatability": Case(
        lambda v: repeatability(v, v + 2.4, np.arange(11.0), 0.23, NOWHERE),
        lambda: rng().normal(0, 0.8, (5, 11)),
        light=False,
    ),
    "edge": Case(lambda v: edge_response(v, "sample", 0.1, NOWHERE), edge),
    "target": Case(lambda v: place_target(v, np.arange(len(v)) - 130.0, TARGET_PLANE, columns()), target),
    "bars": Case(bars, lambda: np.tile(500 + 300 * np.sin(np.arange(60) * np.pi / 10), (5, 1))),
}


def _certificate() -> Any:
    from scanhsi.calibration.lines import line_list

    return line_list("tile", MINIMA_NM)


def spoilt(values: np.ndarray, how: str) -> np.ndarray:
    if how == "empty":
        return values[:0]
    if how == "too short":
        return values[:1]
    if how == "no numbers":
        return np.full_like(values, np.nan)
    if how == "infinite":
        return np.full_like(values, np.inf)
    return np.full_like(values, FULL if how == "saturated" else 0.0)


@pytest.mark.parametrize("name", CASES)
def test_what_is_good_is_taken(name: str) -> None:
    CASES[name].calibrate(CASES[name].values())


def makes_sense(name: str, how: str) -> bool:
    if how == "too short":
        return name not in ("bars", "repeated displacements")  # one line is enough for these
    return CASES[name].light or how not in ("saturated", "no light")


HOW = ("empty", "too short", "no numbers", "infinite", "saturated", "no light")


@pytest.mark.parametrize(("name", "how"), [(name, how) for name in CASES for how in HOW if makes_sense(name, how)])
def test_what_is_not_is_refused_with_a_reason(name: str, how: str) -> None:
    case = CASES[name]
    with pytest.raises(CalibrationError) as error:
        case.calibrate(spoilt(case.values(), how))
    assert str(error.value)
