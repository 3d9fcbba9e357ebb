"""Every figure of the paper from a folder of results, and what is said where something lacks."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest

import scanhsi
from scanhsi import clock
from scanhsi.bench.findings import look_through
from scanhsi.bench.lines import LineSweep, measure_lines
from scanhsi.bench.paper import Made, draw_paper
from scanhsi.calibration.figures.grid import draw_grid
from scanhsi.calibration.geometry import Geometry
from scanhsi.calibration.jitter import jitter
from scanhsi.calibration.lines import hgar
from scanhsi.calibration.resolution import BarContrast
from scanhsi.calibration.result import Provenance, save
from scanhsi.calibration.snr import signal_to_noise
from scanhsi.calibration.wavelength import Wavelength
from scanhsi.cli import run
from scanhsi.devices import PixelFormat, ShowsScenes
from scanhsi.devices.errors import CalibrationError
from scanhsi.engine import Mode
from scanhsi.instrument import load_instrument

RESULTS = [4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14]
NARROW = {"camera.samples": 60, "roi.samples": 60, "roi.sample_offset": 0}
FEW_BANDS = {"roi.samples": 600, "roi.bands": 6, "roi.sample_offset": 724, "roi.band_offset": 480}
GRID = "geometry-cubes/amsler.zarr"
MADE_UP = Provenance(simulated=True, sources=("made-up.zarr",))


async def taken(folder: Path) -> None:
    """What needs cubes; small."""
    async with scanhsi.open_instrument(load_instrument("characterise", NARROW)) as hsi:
        assert isinstance(hsi.camera, ShowsScenes)
        for scene in ("hgar", "wavelength-tile", "white", "dark"):
            await hsi.camera.show(scene)
            plan = hsi.default_plan(lines=3, step=0, start=0, exposure_s=0.05)
            await hsi.scan(plan, folder / "lit" / f"{scene}.zarr", target=scene)
    async with scanhsi.open_instrument(load_instrument("characterise", FEW_BANDS)) as hsi:
        await hsi.calibrate.geometry(folder / "geometry.nc", half_mm=20, exposure_s=0.04)


def wavelength(folder: Path, known_nm: np.ndarray, fwhm_nm: float, *scenes: str) -> Wavelength:
    """As the calibrations would find it."""
    true = np.polynomial.Polynomial([370.79, 0.536, -4e-6])
    band = np.interp(known_nm, true(np.arange(1088.0)), np.arange(1088.0))
    little = np.full(len(band), 0.01)
    cubes = tuple(str(folder / "lit" / f"{scene}.zarr") for scene in (*scenes, "dark"))
    return Wavelength(
        1088, true.coef, np.eye(3) * 1e-12, known_nm, band, little, np.full(len(band), fwhm_nm), little, 0.01, 0.5, len(band),
        "lines.csv", Provenance(simulated=True, sources=cubes),
    )  # fmt: skip


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder as it comes from the commands, moved to another place since."""
    folder = tmp_path_factory.mktemp("paper") / "at-first"
    (folder / "lit").mkdir(parents=True)
    clock.run(taken(folder), virtual=True)
    save(wavelength(folder, hgar().calibrating().within(380, 940).wavelength_nm, 2.9, "hgar"), folder / "wavelength.nc")
    minima = np.linspace(450, 900, 9)
    save(wavelength(folder, minima, np.nan, "wavelength-tile", "white"), folder / "tile.nc")
    rng = np.random.default_rng(1)
    save(jitter(np.arange(300.0), 0.2 * rng.standard_normal(300), MADE_UP, harmonics=0), folder / "jitter.nc")
    save(signal_to_noise({0.02: rng.normal(1, 0.01, (5, 9, 8))}, MADE_UP), folder / "snr.nc")
    for axis, finest in (("line", 0.5), ("sample", 0.2)):
        widths = np.geomspace(2, 0.2, 7)
        contrast = np.clip(1 - finest / widths / 2, 0, 1)
        bars = BarContrast(axis, widths, contrast, finest, 0.2, Provenance(simulated=True, sources=(GRID,)))
        save(bars, folder / f"bars-{axis}.nc")
    rows = [f"{axis},{width},40,60,200,240" for axis in ("line", "sample") for width in (2, 1, 0.5)]
    head = "axis,bar_mm,first_line,last_line,first_sample,last_sample"
    (folder / "bars.csv").write_text("\n".join([head, *rows]))
    sweep = LineSweep(lines=4, exposures_s=[0.02, 0.1], formats=[PixelFormat.MONO8], modes=[Mode.SEQUENTIAL])
    clock.run(measure_lines(load_instrument("sensors2019"), sweep, folder / "bench", command="test"), virtual=True)
    (folder / "other.csv").write_text("a,b\n")
    (folder / "broken.nc").write_bytes(b"no NetCDF")
    return Path(shutil.move(folder, folder.with_name("moved")))


@pytest.fixture(scope="module")
def made(results: Path) -> dict[int, Made]:
    found = draw_paper(look_through([results]), results / "figures", cube=str(results / GRID))
    return {one.figure: one for one in found}


def test_every_figure_of_the_results_has_its_counterpart(made: dict[int, Made]) -> None:
    assert sorted(made) == RESULTS
    for one in made.values():
        png, pdf = one.files
        assert png.name.startswith(f"figure{one.figure}-")
        picture = matplotlib.image.imread(png)
        assert picture.shape[1] == 1460, "as wide as a page"
        assert np.ptp(picture[..., :3]) > 0.9
        assert pdf.read_bytes().startswith(b"%PDF")


def test_a_shaft_out_of_true_is_drawn_as_the_wave_that_it_is() -> None:
    shaft = {"turn_steps": 320.0, "shaft_cos_steps": 1.5, "shaft_sigma_steps": 0.1}
    plane = Geometry(348.73, 0.0, 2 * np.pi / 19_200, 0.1, 599.5, MADE_UP, residual_mm=0.1, **shaft)
    step = np.linspace(-260, 260, 21)
    axes = draw_grid(plane, step, plane.y_mm(step), 6.0).axes[2]
    dots, wave = axes.lines[1], axes.lines[2]
    assert np.ptp(wave.get_ydata()) == pytest.approx(2 * 1.5 * 0.2282, rel=0.02)
    np.testing.assert_allclose(
        dots.get_ydata(), np.interp(step, np.linspace(-260, 260, 300), wave.get_ydata()), atol=0.01
    )


def test_what_is_missing_in_a_figure_is_told(made: dict[int, Made]) -> None:
    assert made[12].lacks == "one of its halves: run `scanhsi calibrate light INSTRUMENT -o light.nc`"
    assert {number for number, one in made.items() if one.lacks} == {12}


def test_nothing_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "in").mkdir()
    words = ["figures", str(tmp_path / "in"), "-o", str(tmp_path / "out")]
    assert run(words) == 4
    told = capsys.readouterr()
    assert "none of the 11 figures could be drawn" in told.err
    for number, command in (
        (8, "calibrate jitter"),
        (7, "calibrate geometry"),
        (9, "wavelength-tile"),
        (5, "bench lines"),
    ):
        assert f"figure {number:2}" in told.out
        assert command in told.out
    assert "--cube" in told.out
    with pytest.raises(CalibrationError, match="there is no"):
        look_through([tmp_path / "nowhere"])


def test_some_results_on_the_command_line(results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    alone = tmp_path / "alone"
    alone.mkdir()
    for name in ("wavelength.nc", "jitter.nc", "bars-line.nc"):
        shutil.copy(results / name, alone / name)
    assert run(["figures", str(alone), "-o", str(tmp_path / "out"), "--json"]) == 0
    told = {one["figure"]: one for one in json.loads(capsys.readouterr().out)["figures"]}
    assert {number for number, one in told.items() if one["files"]} == {8, 11}
    assert "is not there any more" in told[10]["lacks"]  # its cubes stayed behind
    assert told[11]["lacks"].startswith("the picture: its cube")
