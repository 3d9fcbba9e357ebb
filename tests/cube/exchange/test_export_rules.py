"""What holds for every format: nothing is overwritten, nothing half-done is left, and errors say what to do."""

from __future__ import annotations

import errno
import io
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scanhsi import ConfigError, CubeError, export_cube
from scanhsi.cube.exchange import output as output_module
from scanhsi.cube.exchange.source import Source
from scanhsi.devices.errors import CubeExists, NotACube
from support.exports import make_cube, pixels_of

OUTPUTS = ["out.bil", "out.bsq", "out.bip", "out.hdr", "out.nc", "out.mat", "out.ome.tif", "out.png"]
WAVELENGTH_NM = np.linspace(400.0, 1000.0, 7)


@pytest.fixture
def cube(tmp_path: Path) -> Path:
    return make_cube(tmp_path / "c.zarr", pixels_of((7, 12, 5), "uint16", 12), wavelength_nm=WAVELENGTH_NM)


def seen(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


@pytest.mark.parametrize("name", OUTPUTS)
def test_nothing_is_overwritten(cube: Path, name: str) -> None:
    (cube.parent / name).write_text("precious")
    with pytest.raises(CubeExists, match=f"{name} exists already"):
        export_cube(cube, cube.parent / name, bands="0")
    assert (cube.parent / name).read_text() == "precious"
    assert seen(cube.parent) == {"c.zarr", name}


def test_neither_is_the_other_file_of_envi(cube: Path) -> None:
    (cube.parent / "out.hdr").write_text("precious")
    with pytest.raises(CubeExists, match=r"out\.hdr exists already"):
        export_cube(cube, cube.parent / "out.bil")
    assert seen(cube.parent) == {"c.zarr", "out.hdr"}


@pytest.mark.parametrize("name", OUTPUTS)
def test_a_failure_in_the_middle_leaves_nothing(cube: Path, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    original = Source._read
    calls = 0

    def fails(*args: Any) -> Any:
        nonlocal calls
        calls += 1
        if calls == 1:
            return original(*args)
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("scanhsi.cube.exchange.source.BLOCK_BYTES", 1)
    monkeypatch.setattr(Source, "_read", fails)
    bands = "0" if name.endswith("png") else None
    with pytest.raises(CubeError, match="is full"):
        export_cube(cube, cube.parent / name, bands=bands)
    assert calls == 2
    assert seen(cube.parent) == {"c.zarr"}


@pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError])
def test_interrupted_by_the_caller_it_leaves_nothing(cube: Path, error: type[BaseException]) -> None:
    def stop(done: int, total: int) -> None:
        raise error

    with pytest.raises(error):
        export_cube(cube, cube.parent / "out.bil", progress=stop)
    assert seen(cube.parent) == {"c.zarr"}


DIE = """
import os, signal, sys
import scanhsi
from scanhsi.cube.exchange import importing, source

source.BLOCK_BYTES = importing._BLOCK_BYTES = 1
work = scanhsi.import_cube if sys.argv[2].endswith("zarr") else scanhsi.export_cube
work(sys.argv[1], sys.argv[2], progress=lambda done, total: os.kill(os.getpid(), signal.SIGKILL))
"""


@pytest.mark.parametrize("name", ["out.bsq", "out.nc", "back.zarr"])
def test_killed_it_leaves_nothing_under_the_name(cube: Path, name: str) -> None:
    export_cube(cube, cube.parent / "before.bil")
    origin = cube.parent / "before.bil" if name == "back.zarr" else cube
    before = seen(cube.parent)
    done = subprocess.run([sys.executable, "-c", DIE, str(origin), str(cube.parent / name)], timeout=60, check=False)
    assert done.returncode == -signal.SIGKILL
    left = seen(cube.parent) - before
    assert left
    assert all(path.startswith(".") and path.endswith(".partial") for path in left)


def test_a_file_that_came_meanwhile_is_not_replaced(cube: Path) -> None:
    def intrude(done: int, total: int) -> None:
        (cube.parent / "out.hdr").write_text("precious")

    with pytest.raises(CubeExists, match=r"out\.hdr exists by now"):
        export_cube(cube, cube.parent / "out.bil", progress=intrude)
    assert (cube.parent / "out.hdr").read_text() == "precious"
    assert seen(cube.parent) == {"c.zarr", "out.hdr"}


def test_file_systems_without_hard_links(cube: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.EPERM, "no links here")

    monkeypatch.setattr(output_module.Path, "hardlink_to", refuse)
    export_cube(cube, cube.parent / "out.bil")
    assert seen(cube.parent) == {"c.zarr", "out.hdr", "out.bil"}


def test_progress_counts_the_bytes(cube: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("scanhsi.cube.exchange.source.BLOCK_BYTES", 1)
    told: list[tuple[int, int]] = []
    export_cube(cube, cube.parent / "out.bil", progress=lambda done, total: told.append((done, total)))
    assert told == [(280, 840), (560, 840), (840, 840)]


@pytest.mark.parametrize(
    ("bands", "expected"),
    [
        ("3", [3]),
        ("5, 0:2", [5, 0, 1]),
        ("803nm", [4]),
        ("450nm:700nm", [1, 2, 3]),
        ("700nm:450nm,6", [1, 2, 3, 6]),
        ([6, 2], [6, 2]),
        (None, list(range(7))),
    ],
)
def test_choice_of_bands(cube: Path, bands: Any, expected: list[int]) -> None:
    export_cube(cube, cube.parent / "out.bsq", bands=bands, lines="2:-1")
    pixels = pixels_of((7, 12, 5), "uint16", 12)[expected, 2:-1]
    assert (cube.parent / "out.bsq").read_bytes() == pixels.tobytes()
    header = (cube.parent / "out.hdr").read_text()
    listed = ", ".join(str(nm) for nm in WAVELENGTH_NM[expected].tolist())  # up to 8 in a row
    assert f"wavelength = {{{listed}}}" in header


@pytest.mark.parametrize(
    ("options", "fragment"),
    [
        ({"bands": "7"}, "has bands 0 to 6"),
        ({"bands": "red"}, "'red' is neither an index"),
        ({"bands": "1:2:3"}, "two ends"),
        ({"bands": "1:500nm"}, "both ends"),
        ({"bands": "1.5"}, "whole number"),
        ({"bands": "1,1"}, "twice"),
        ({"bands": "10nm:20nm"}, "none of the 7 bands"),
        ({"lines": "5"}, "first:end"),
        ({"lines": slice(0, 9, 2)}, "steps are not"),
    ],
)
def test_wrong_choices(cube: Path, options: dict[str, Any], fragment: str) -> None:
    with pytest.raises(ConfigError, match=fragment):
        export_cube(cube, cube.parent / "out.bil", **options)
    assert seen(cube.parent) == {"c.zarr"}


def test_no_line_chosen(cube: Path) -> None:
    with pytest.raises(CubeError, match="has lines 0 to 11; none of them"):
        export_cube(cube, cube.parent / "out.bil", lines="12:")


def test_wavelengths_of_a_cube_without_them(tmp_path: Path) -> None:
    make_cube(tmp_path / "c.zarr", pixels_of((2, 2, 2), "uint8", 8), bits=8)
    with pytest.raises(ConfigError, match="no wavelengths"):
        export_cube(tmp_path / "c.zarr", tmp_path / "out.bil", bands="500nm")


def test_an_empty_cube_is_refused(tmp_path: Path) -> None:
    make_cube(tmp_path / "c.zarr", np.empty((3, 0, 4), np.uint8), bits=8, planned=5)
    with pytest.raises(CubeError, match="holds no line yet"):
        export_cube(tmp_path / "c.zarr", tmp_path / "out.nc")


@pytest.mark.parametrize(
    ("name", "fragment"), [("out.pkl", "no pickle, ever"), ("out.npz", "no pickle, ever"), ("out.xyz", "no ending")]
)
def test_unknown_endings(cube: Path, name: str, fragment: str) -> None:
    with pytest.raises(ConfigError, match=fragment):
        export_cube(cube, cube.parent / name)


def test_paths_that_are_no_cube_and_folders_that_are_not_there(cube: Path) -> None:
    with pytest.raises(NotACube, match="there is no"):
        export_cube(cube.parent / "nothing.zarr", cube.parent / "out.bil")
    with pytest.raises(CubeError, match="there is no folder"):
        export_cube(cube, cube.parent / "nowhere" / "out.bil")


def test_formats_by_name(cube: Path) -> None:
    done = export_cube(cube, cube.parent / "out.xyz", format="envi")
    assert done.paths == (cube.parent / "out.hdr", cube.parent / "out.xyz")


def test_the_command(cube: Path, capsys: pytest.CaptureFixture[str]) -> None:
    import json

    from scanhsi.cli import run

    assert run(["export", str(cube), "-o", str(cube.parent / "out.nc"), "--bands", "500nm", "--json"]) == 0
    told = json.load(io.StringIO(capsys.readouterr().out))
    assert told["format"] == "netcdf"
    assert told["shape"] == [1, 12, 5]
    assert run(["import", str(cube.parent / "out.nc"), "-o", str(cube.parent / "back.zarr")]) == 0
    assert "from scanhsi NetCDF, 1 bands x 12 lines x 5 samples, uint16" in capsys.readouterr().out
    assert run(["export", str(cube), "-o", str(cube.parent / "out.nc")]) == 4
    assert "exists already" in capsys.readouterr().err
