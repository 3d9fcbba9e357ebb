"""From calibrations to reflectance and the sheet, on the command line."""

from __future__ import annotations

import json
from datetime import timedelta
from pathlib import Path

import numpy as np
import pytest

from scanhsi.calibration import figures
from scanhsi.calibration.kinds import KINDS
from scanhsi.cli.calibrations import KINDS as COMMANDS
from scanhsi.cli.quantities import limits_of
from scanhsi.cube.reader import open_cube
from support.command_line import Cli

SMALL = """
[camera]
driver = "simulated"
profile = "ideal"
scene = "white"
bands = 40
samples = 64
[actuator]
driver = "simulated"
profile = "ideal"
[geometry]
distance = "350 mm"
normal_step = 0
[scan]
lines = 12
exposure = "30 ms"
"""


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "small.toml"
    path.write_text(SMALL)
    return path


def test_models_make_reflectance_and_a_sheet(cli: Cli, config: Path, tmp_path: Path) -> None:
    dark, white, cube = (str(tmp_path / name) for name in ("dark.nc", "white.nc", "tile.zarr"))
    result = cli("calibrate", "dark", config, "-o", dark, "--virtual", "--frames", "5", "--json")
    assert result.code == 0, result.err
    told = result.object
    assert (told["kind"], told["simulated"], len(told["sources"])) == ("dark", True, 8)
    assert Path(told["figure"]).stat().st_size > 10_000
    result = cli("calibrate", "white", config, "--dark", dark, "-o", white, "--virtual", "--no-figure", "--json")
    assert result.code == 0, result.err
    assert cli("scan", config, "-o", cube, "--virtual", "--step", "0").code == 0

    out = tmp_path / "reflectance.zarr"
    result = cli("process", cube, "-o", str(out), "--dark", dark, "--white", white, "--json")
    assert result.code == 0, result.err
    (_, corrected, reflected) = result.object["processed"][0]["processing"]
    assert corrected["source"] == dark
    assert reflected["tile"] == 0.99
    lit = slice(10, 35)  # the lamp gives next to nothing at the ends of the spectrum
    assert abs(np.nanmedian(open_cube(out)["cube"].values[lit]) - 0.99) < 0.01

    sheet = tmp_path / "spec.json"
    markdown, pdf = tmp_path / "spec.md", tmp_path / "spec.pdf"
    result = cli("spec", dark, white, "--instrument", config, "-o", str(sheet), "-o", str(markdown), "-o", str(pdf))
    assert result.code == 0, result.err
    assert pdf.read_bytes().startswith(b"%PDF")
    assert "SIMULATED" in markdown.read_text()
    rows = {row["key"]: row for row in json.loads(sheet.read_text())["table"]}
    assert len(rows) == 14
    assert rows["usaf"]["value"] == "not measured"


def test_the_same_result_from_the_cubes_that_were_kept(cli: Cli, config: Path, tmp_path: Path) -> None:
    first, again = (str(tmp_path / name) for name in ("dark.nc", "again.nc"))
    taken = cli("calibrate", "dark", config, "-o", first, "--virtual", "--frames", "4", "--no-figure", "--json")
    words = [word for cube in sorted((tmp_path / "dark-cubes").iterdir()) for word in ("--from", str(cube))]
    repeated = cli("calibrate", "dark", "-o", again, *words, "--no-figure", "--json")
    assert repeated.code == 0, repeated.err
    assert repeated.object["values"] == taken.object["values"]


def test_an_instrument_or_cubes_and_not_both(cli: Cli, config: Path, tmp_path: Path) -> None:
    for words in ([], [str(config), "--from", "x.zarr"]):
        result = cli("calibrate", "dark", *words, "-o", str(tmp_path / "dark.nc"))
        assert result.code == 2
        assert "one of the two" in result.err


def test_a_cube_is_no_dark_model(cli: Cli, config: Path, tmp_path: Path) -> None:
    (tmp_path / "not.nc").write_text("nothing")
    result = cli("calibrate", "white", config, "--dark", tmp_path / "not.nc", "-o", str(tmp_path / "w.nc"), "--virtual")
    assert result.code == 4
    assert "no NetCDF-4 file" in result.err


@pytest.mark.parametrize(
    ("text", "age"),
    [("90 min", timedelta(minutes=90)), ("12h", timedelta(hours=12)), ("any", timedelta.max), (None, None)],
)
def test_ages(text: str | None, age: timedelta | None) -> None:
    assert limits_of(text, 5.0).max_age == age


def test_a_dark_model_that_is_older_than_asked_for_is_refused_with_cubes_that_exist(
    cli: Cli, config: Path, tmp_path: Path
) -> None:
    dark, white, again = (str(tmp_path / name) for name in ("dark.nc", "white.nc", "again.nc"))
    exposures = ["--exposures", "10 ms, 60 ms", "--frames", "3", "--no-figure"]
    assert cli("calibrate", "dark", config, "-o", dark, "--virtual", *exposures).code == 0
    some = ["--exposure", "20 ms", "--frames", "3", "--no-figure", "--dark", dark]
    assert cli("calibrate", "white", config, "-o", white, "--virtual", *some).code == 0
    words = ["calibrate", "white", "--from", str(tmp_path / "white-cubes" / "white.zarr"), "--dark", dark, "-o", again]
    refused = cli(*words, "--max-age", "0 min")
    assert refused.code == 4
    assert f"the dark model {dark} does not apply" in refused.err
    assert "--max-age '1 d' to use it all the same" in refused.err
    assert cli(*words, "--no-figure").code == 0
    wrong = cli(*words, "--max-age", "3 moons")
    assert wrong.code == 2
    assert "min, h, d" in wrong.err


def test_every_kind_has_its_command_and_its_figure(cli: Cli) -> None:
    told = cli("calibrate", "--help").out
    assert all(kind.__name__.replace("_", "-") in told for kind in COMMANDS)
    assert not set(KINDS) - set(figures.FIGURES)


def test_a_plan_of_a_field(cli: Cli) -> None:
    result = cli("plan", "sensors2019", "--height", "100", "--json")
    assert result.code == 0, result.err
    assert result.object["step"] == 1
    assert result.object["linear"] is True
