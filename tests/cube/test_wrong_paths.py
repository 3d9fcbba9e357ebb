"""Paths that are no cube, or must not become one: clear words, and nothing is touched."""

from __future__ import annotations

from pathlib import Path

import pytest
import zarr

from scanhsi import clock
from scanhsi.cube.layout import CubeSpec
from scanhsi.cube.reader import cube_summary, open_cube, read_records
from scanhsi.devices.errors import CubeError, CubeExists, NotACube
from support.cubes import write_cube


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    spec = CubeSpec(3, 2, 2, "uint8", 8)
    (tmp_path / "file").write_text("precious")
    (tmp_path / "folder").mkdir()
    (tmp_path / "dangling").symlink_to(tmp_path / "nowhere")
    clock.run(write_cube(tmp_path / "cube", spec), virtual=True)
    before = {file: file.read_bytes() for file in tmp_path.rglob("*") if file.is_file()}
    for name in ("file", "folder", "dangling", "cube"):
        with pytest.raises(CubeExists, match=f"{name} exists already"):
            clock.run(write_cube(tmp_path / name, spec), virtual=True)
    assert before == {file: file.read_bytes() for file in tmp_path.rglob("*") if file.is_file()}


def test_unusable_folders(tmp_path: Path) -> None:
    spec = CubeSpec(3, 2, 2, "uint8", 8)
    (tmp_path / "file").write_text("")
    for path in (tmp_path / "no/cube.zarr", tmp_path / "file/cube.zarr"):
        with pytest.raises(CubeError, match="no folder"):
            clock.run(write_cube(path, spec), virtual=True)
    with pytest.raises(CubeError, match=r"cannot write /proc/cube\.zarr"):
        clock.run(write_cube(Path("/proc/cube.zarr"), spec), virtual=True)


@pytest.mark.parametrize("kind", ["missing", "file", "folder", "array", "group", "newer", "damaged"])
def test_not_a_cube(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "x.zarr"
    if kind == "file":
        path.write_text("hello")
    elif kind == "folder":
        path.mkdir()
    elif kind == "array":
        zarr.create_array(path, shape=(3,), dtype="uint8")
    elif kind == "group":
        zarr.create_group(path)
    elif kind in ("newer", "damaged"):
        zarr.create_group(path, attributes={"scanhsi_format": 2 if kind == "newer" else 1})
    expected, text = {
        "missing": (NotACube, "there is no"),
        "file": (NotACube, "is a file"),
        "folder": (NotACube, "no Zarr group"),
        "array": (NotACube, "no Zarr group"),
        "group": (NotACube, "did not write it"),
        "newer": (CubeError, "newer scanhsi"),
        "damaged": (CubeError, "lacks its array 'status'"),
    }[kind]
    for read in (open_cube, read_records, cube_summary):
        with pytest.raises(expected, match=text):
            read(path)
