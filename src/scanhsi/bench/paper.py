"""Every figure of the paper's results from one's own data: stored results, the cubes they were made from, records of the bench."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final, TypeVar

import numpy as np
from matplotlib.figure import Figure

from scanhsi.bench.curves import curves
from scanhsi.bench.figures import draw_figures
from scanhsi.bench.findings import Found
from scanhsi.bench.observations import Session, read_sessions
from scanhsi.calibration.dark import DarkModel
from scanhsi.calibration.figures.bars import draw_bar_target
from scanhsi.calibration.figures.grid import draw_distortion, draw_grid
from scanhsi.calibration.figures.noise_and_light import draw_noise_and_light
from scanhsi.calibration.figures.optics import draw_jitter
from scanhsi.calibration.figures.spectrograph import draw_lamp, draw_tile
from scanhsi.calibration.figures.style import save_figure
from scanhsi.calibration.figures.view import draw_view
from scanhsi.calibration.geometry import Geometry
from scanhsi.calibration.jitter import Jitter
from scanhsi.calibration.light import LightStability
from scanhsi.calibration.lines import hgar
from scanhsi.calibration.resolution import BarContrast
from scanhsi.calibration.result import Result
from scanhsi.calibration.snr import SignalToNoise
from scanhsi.calibration.view import view
from scanhsi.calibration.wavelength import Wavelength
from scanhsi.characterise.bars_from_cube import load_bars
from scanhsi.characterise.evidence import bar_target, grid_points, middle_spectra, sources_of, tile_reflectance
from scanhsi.devices.errors import CalibrationError, CubeError, ScanhsiError

R = TypeVar("R", bound=Result)
Draw = Callable[[], Figure]

_BENCH: Final = {5: "time of a line by stage", 6: "lines per second", 13: "efficiency"}
_SPECTRA: Final = 100


@dataclass(frozen=True, slots=True)
class Made:
    """What became of one figure.

    Attributes:
        figure: Its number in the paper.
        title: What it shows.
        files: That were written; empty if it could not be drawn.
        lacks: What it would need, and how to get that; of a figure that was drawn, what is missing in it.
    """

    figure: int
    title: str
    files: tuple[Path, ...] = ()
    lacks: str = ""


def draw_paper(found: Found, folder: Path, *, cube: str | None = None) -> Iterator[Made]:
    """Draw what can be drawn, each figure as PNG and as PDF.

    Args:
        found: What there is; of several results of a kind the youngest is drawn.
        folder: Where figures go.
        cube: For figure 14.

    Yields:
        What became of each figure, in the order of the paper.

    Raises:
        CalibrationError, CubeError: A file cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CalibrationError(f"cannot create {folder}: {error.strerror or error}.") from error
    timing = _timing(found, folder)
    for number in sorted([*_FIGURES, *_BENCH, 14]):
        if number in _BENCH:
            yield timing[number]
        elif number == 14:
            yield _drawn(number, "cube", "an image, a band, spectra", lambda: _cube(cube), folder)
        else:
            name, title, prepare = _FIGURES[number]
            yield _drawn(number, name, title, partial(prepare, found), folder)


def _drawn(number: int, name: str, title: str, prepare: Callable[[], tuple[Draw, str]], folder: Path) -> Made:
    try:
        draw, lacks = prepare()
    except ScanhsiError as error:
        return Made(number, title, lacks=" ".join(str(error).split()))
    files = folder / f"figure{number}-{name}.png", folder / f"figure{number}-{name}.pdf"
    save_figure(draw, *files)
    return Made(number, title, files, lacks)


def _timing(found: Found, folder: Path) -> dict[int, Made]:
    """Figures of the bench, from its last session with whole scans."""
    lacks = "no records of the bench: run `scanhsi bench lines INSTRUMENT -o bench`"
    files: list[Path] = []
    sessions: list[Session] = []
    try:
        sessions = [session for path in found.records for session in read_sessions(path)]
    except (CubeError, KeyError, ValueError) as error:
        lacks = f"the records of the bench cannot be read: {error}"
    if sessions:
        last = max(sessions, key=lambda session: str(session.facts.get("started", "")))
        files = draw_figures(last, curves(last.observations), folder)
        lacks = "the bench measured no whole scans"
    made: dict[int, Made] = {}
    for number, title in _BENCH.items():
        own = sorted((file for file in files if file.name.startswith(f"figure{number}-")), reverse=True)  # .png first
        made[number] = Made(number, title, tuple(own), "" if own else lacks)
    return made


def _cube(cube: str | None) -> tuple[Draw, str]:
    if cube is None:
        raise CalibrationError("no cube was named: --cube hand.zarr")
    look = view(cube, spectra=_SPECTRA)
    return lambda: draw_view(look, cube.rstrip("/").rpartition("/")[2]), ""


def _youngest(
    found: Found, kind: type[R], command: str, wanted: Callable[[R], bool] = lambda _: True
) -> tuple[R, Path]:
    pair = found.youngest(kind, wanted)
    if pair is None:
        raise CalibrationError(f"no {command.split()[0]} result: run `scanhsi calibrate {command}`")
    return pair


def _distortion(found: Found) -> tuple[Draw, str]:
    plane, _ = _youngest(found, Geometry, "geometry INSTRUMENT -o geometry.nc")
    return lambda: draw_distortion(plane), ""


def _grid(found: Found) -> tuple[Draw, str]:
    plane, path = _youngest(found, Geometry, "geometry INSTRUMENT -o geometry.nc")
    points = grid_points(sources_of(plane, path)[0], plane)
    return lambda: draw_grid(plane, points.step, points.y_mm, points.pitch_mm), ""


def _jitter(found: Found) -> tuple[Draw, str]:
    result, _ = _youngest(found, Jitter, "jitter INSTRUMENT -o jitter.nc")
    return lambda: draw_jitter(result), ""


def _dark(found: Found) -> DarkModel | None:
    pair = found.youngest(DarkModel)
    return None if pair is None else pair[0]


def _is_lamp(result: Wavelength) -> bool:
    return bool(
        np.isfinite(result.line_fwhm_nm).any()
    )  # a tile's bands are wide by themselves: they tell no resolution


def _tile(found: Found) -> tuple[Draw, str]:
    result, path = _youngest(
        found, Wavelength, "wavelength-tile INSTRUMENT --certificate tile.csv -o tile.nc", lambda one: not _is_lamp(one)
    )
    seen = tile_reflectance(_spectra(found, result, path))
    return lambda: draw_tile(result, seen), ""


def _lamp(found: Found) -> tuple[Draw, str]:
    result, path = _youngest(found, Wavelength, "wavelength INSTRUMENT -o wavelength.nc", _is_lamp)
    spectra = _spectra(found, result, path)
    if len(spectra) != 1:
        raise CalibrationError(f"{path} was made from cubes of {', '.join(spectra)}; one of a lamp is needed.")
    return lambda: draw_lamp(result, next(iter(spectra.values())), hgar()), ""


def _spectra(found: Found, result: Wavelength, path: Path) -> dict[str, np.ndarray[tuple[int], np.dtype[np.float64]]]:
    """With the dark cubes that the result was made from; if it was made with a dark model, with that."""
    cubes = sources_of(result, path)
    own_dark = any("dark" in cube.name for cube in cubes)
    return middle_spectra(cubes, None if own_dark else _dark(found))


def _along(axis: str, result: BarContrast) -> bool:
    return result.axis == axis


def _bars(found: Found) -> tuple[Draw, str]:
    named = "resolution --from usaf.zarr --usaf -o usaf-line.nc"
    line, sample = (found.youngest(BarContrast, partial(_along, axis)) for axis in ("line", "sample"))
    results = [pair for pair in (line, sample) if pair is not None]
    if not results:
        raise CalibrationError(f"no contrast of bars: run `scanhsi calibrate {named}`, and with `--axis sample`")
    plane = found.youngest(Geometry)
    lacks = "" if len(results) == 2 else "the other axis: `--axis line` and `--axis sample`"
    contrasts = [result for result, _ in results]
    try:
        table = load_bars(found.bars[-1]) if found.bars else None
        target = bar_target(sources_of(*results[0])[0], table, plane and plane[0])
    except CalibrationError as error:
        return lambda: draw_bar_target(contrasts, None, None), f"the picture: {' '.join(str(error).split())}"
    if not target.profiles:
        lacks = f"cross-sections: {target.lacks}"
    return lambda: draw_bar_target(contrasts, target.picture, target.extent_mm, target.profiles), lacks


def _noise_and_light(found: Found) -> tuple[Draw, str]:
    snr, light = found.youngest(SignalToNoise), found.youngest(LightStability)
    wavelength = found.youngest(Wavelength, _is_lamp) or found.youngest(Wavelength)
    commands = [
        *(["`scanhsi calibrate snr INSTRUMENT -o snr.nc`"] if snr is None else []),
        *(["`scanhsi calibrate light INSTRUMENT -o light.nc`"] if light is None else []),
    ]
    if snr is None and light is None:
        raise CalibrationError(f"neither signal to noise nor light was measured: run {' and '.join(commands)}")
    lacks = f"one of its halves: run {commands[0]}" if commands else ""
    return lambda: draw_noise_and_light(snr and snr[0], light and light[0], wavelength and wavelength[0]), lacks


_FIGURES: Final[dict[int, tuple[str, str, Callable[[Found], tuple[Draw, str]]]]] = {
    4: ("distortion", "what the mirror sees of a plane", _distortion),
    7: ("grid", "grid and distance", _grid),
    8: ("jitter", "jitter of the mirror", _jitter),
    9: ("wavelength-tile", "wavelengths from a tile", _tile),
    10: ("lamp", "lines of a lamp, spectral resolution", _lamp),
    11: ("bars", "resolution of a bar target", _bars),
    12: ("noise-and-light", "signal to noise, and stability of the light", _noise_and_light),
}
"""Number in the paper: name of the file, title, and what prepares it from what was found: raises what it lacks."""
