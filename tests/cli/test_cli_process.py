from dataclasses import replace

import numpy as np
import pytest

from scanhsi.calibration.conditions import Conditions
from scanhsi.calibration.dark import DarkModel
from scanhsi.calibration.result import Provenance, save
from scanhsi.cli import run as run_here
from scanhsi.cube.reader import cube_summary, open_cube
from support.command_line import Cli

SMALL = """
[camera]
driver = "simulated"
profile = "ideal"
scene = "testpattern"
bands = 40
samples = 64
[actuator]
driver = "simulated"
profile = "ideal"
[geometry]
distance = "350 mm"
normal_step = 0
[scan]
lines = 20
exposure = "20 ms"
"""


@pytest.fixture(scope="module")
def cubes(tmp_path_factory):
    folder = tmp_path_factory.mktemp("cubes")
    config = folder / "small.toml"
    config.write_text(SMALL)
    for name in ("hand", "other", "dark", "white"):
        assert run_here(["scan", str(config), "-o", str(folder / f"{name}.zarr")]) == 0
    return folder


def test_process_makes_a_cube_that_says_how(cli: Cli, cubes, tmp_path):
    out = tmp_path / "r.zarr"
    result = cli(
        "process",
        (cubes / "hand.zarr"),
        "-o",
        str(out),
        "--dark",
        (cubes / "dark.zarr"),
        "--bin-bands",
        "5",
        "--json",
    )
    assert result.code == 0, result.err
    told = result.object["processed"][0]
    assert told["output"] == str(out)
    assert [step["step"] for step in told["processing"]] == ["mask saturated", "subtract dark", "bin bands"]
    assert open_cube(out)["cube"].shape == (8, 20, 64)
    assert cube_summary(out).complete


def test_many_cubes_at_once(cli: Cli, cubes, tmp_path):
    result = cli("process", (cubes / "[ho]*.zarr"), "-o", str(tmp_path), "--bin-bands", "4")
    assert result.code == 0, result.err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["hand-reflectance.zarr", "other-reflectance.zarr"]


@pytest.mark.parametrize(
    ("arguments", "why", "code"),
    [
        (["hand.zarr", "--white", "white.zarr"], "needs a dark reference", 2),
        (["hand.zarr"], "nothing to do", 2),
        (["no*.zarr", "--bin-bands", "2"], "no cube matches", 2),
        (["*.zarr", "--bin-bands", "2", "-o", "nowhere"], "need a folder", 2),
        (["hand.zarr", "--bin-bands", "99"], "99 bands cannot be binned", 4),
        (["hand.zarr", "--dark", "hand.zarr", "--white", "dark.zarr", "--tile", "5"], "reflectance of 5", 4),
        (["none.zarr", "--bin-bands", "2"], "there is no none.zarr", 4),
    ],
)
def test_what_cannot_be_processed(cli: Cli, cubes, arguments, why, code, monkeypatch):
    monkeypatch.chdir(cubes)
    before = sorted(path.name for path in cubes.iterdir())
    result = cli("process", *arguments)
    assert result.code == code, result.err
    assert why in " ".join(result.err.replace("│", " ").split())
    assert sorted(path.name for path in cubes.iterdir()) == before


def test_no_scheduler_at_that_address(cli: Cli, cubes, monkeypatch):
    monkeypatch.setattr("distributed.Client", _no_client)
    result = cli("process", (cubes / "hand.zarr"), "--bin-bands", "2", "--scheduler", "tcp://127.0.0.1:1")
    assert result.code == 2
    assert "no dask scheduler answers at tcp://127.0.0.1:1" in result.err


def _no_client(*_args, **_more):
    raise OSError("timed out")


def test_repack_replaces_the_cube(cli: Cli, cubes, tmp_path):
    path = tmp_path / "raw.zarr"
    result = cli("scan", (cubes / "small.toml"), "--raw", "-o", str(path))
    assert result.code == 0, result.err
    before = open_cube(path)["cube"].values
    result = cli("repack", str(path))
    assert result.code == 0, result.err
    assert "times smaller" in result.out
    np.testing.assert_array_equal(open_cube(path)["cube"].values, before)
    assert cube_summary(path).attributes["storage"]["codec"] == "lz4"


def test_a_scan_makes_its_reflectance_as_it_scans(cli: Cli, cubes, tmp_path):
    dark = ("--dark", cubes / "dark.zarr", "--bin-bands")
    scan = ("scan", cubes / "small.toml", "-o", tmp_path / "raw.zarr", "--dark", cubes / "dark.zarr", "--json")
    result = cli(*scan)
    assert result.code == 2
    assert "--reflectance" in result.err
    result = cli(*scan, "--reflectance", tmp_path / "live.zarr", "--average-bands", "5")
    assert result.code == 0, result.err
    assert result.object["processed"]["lines"] == 20
    assert result.object["processed"]["error"] is None
    result = cli("process", tmp_path / "raw.zarr", "-o", tmp_path / "followed.zarr", *dark, "5", "--follow")
    assert result.code == 0, result.err
    live, followed = open_cube(tmp_path / "live.zarr"), open_cube(tmp_path / "followed.zarr")
    np.testing.assert_array_equal(live["cube"].values, followed["cube"].values)
    assert live.attrs["complete"]
    result = cli(*scan, "--reflectance", tmp_path / "live.zarr")
    assert result.code == 4
    assert "exists already" in result.err


def test_a_dark_model_of_another_gain_or_day_is_refused(cli: Cli, cubes, tmp_path):
    conditions = Conditions.of(open_cube(cubes / "hand.zarr", chunks=None).attrs)
    save_dark(tmp_path / "gain.nc", replace(conditions, gain_db=6.0), conditions.taken)
    save_dark(tmp_path / "old.nc", conditions, "2020-01-01T00:00:00+00:00")
    process = ("process", cubes / "hand.zarr", "-o", tmp_path / "r.zarr", "--dark")
    result = cli(*process, tmp_path / "gain.nc")
    assert result.code == 4
    assert "gain 6 dB instead of" in result.err
    result = cli(*process, tmp_path / "old.nc")
    assert result.code == 4
    assert "older than what it is used on" in result.err
    assert not (tmp_path / "r.zarr").exists()
    scan = (
        "scan",
        cubes / "small.toml",
        "-o",
        tmp_path / "raw.zarr",
        "--reflectance",
        tmp_path / "live.zarr",
        "--dark",
    )
    result = cli(*scan, tmp_path / "old.nc")
    assert result.code == 4
    assert "older than what it is used on" in result.err
    assert not (tmp_path / "raw.zarr").exists()
    result = cli(*process, tmp_path / "old.nc", "--max-age", "any")
    assert result.code == 0, result.err


def save_dark(path, conditions: Conditions, taken: str | None) -> None:
    """A dark model of the small camera, taken so and then."""
    zero = np.zeros((40, 64))
    provenance = Provenance((), replace(conditions, exposure_s=None), True, taken=taken)
    save(DarkModel(zero, zero, zero + 1, zero + 1, zero, zero + 1, zero > 1, zero > 1, 0.01, 2.0, 8, provenance), path)
