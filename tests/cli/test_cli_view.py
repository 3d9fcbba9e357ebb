"""`scanhsi view`: pictures and spectra of cubes, on the command line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import scanhsi
from support.command_line import Cli


@pytest.fixture
def cube(cli: Cli, mini: Path, tmp_path: Path) -> Path:
    path = tmp_path / "a.zarr"
    assert cli("scan", mini, "-o", path, "--virtual").code == 0
    return path


def test_picture_and_spectra(cli: Cli, cube: Path, tmp_path: Path) -> None:
    told = cli(
        "view", cube, "-o", tmp_path / "a.png", "--region", "1:4,2:6", "--region", "5,3", "--spectra", 9, "--json"
    )
    assert told.code == 0
    assert told.object["simulated"] is True
    assert told.object["lines"] == 6
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    region, pixel = told.object["regions"]
    values = scanhsi.open_cube(cube, chunks=None)["cube"].values.astype(float)
    np.testing.assert_allclose(region["mean"], values[:, 1:4, 2:6].mean(axis=(1, 2)))
    np.testing.assert_allclose(region["sigma"], values[:, 1:4, 2:6].reshape(len(values), -1).std(axis=1, ddof=1))
    assert set(region["count"]) == {12}
    np.testing.assert_array_equal(pixel["mean"], values[:, 5, 3])
    assert set(pixel["sigma"]) == {None}


def test_the_picture_is_named_after_the_cube(
    cli: Cli, cube: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli("view", f"{cube}/", "--spectra", 0).code == 0
    assert (tmp_path / "a.png").exists()
    assert cli("view", cube, "-o", "b.pdf", "--illuminant", "3200 K").code == 0
    assert (tmp_path / "b.pdf").read_bytes().startswith(b"%PDF")


@pytest.mark.parametrize(
    ("words", "code", "why"),
    [
        (("-o", "a.jpg"), 2, "is no .png, .pdf, .svg file"),
        (("--region", "1:2"), 2, "is no region"),
        (("--region=-3:2,1:2",), 2, "is no region"),
        (("--region", "99,0"), 4, "hold no pixel"),
        (("--illuminant", "candle"), 2, "there is no light 'candle'"),
        (("--ratio", "760"), 4, "has no wavelengths"),
        (("-o", "no/folder.png"), 4, "cannot write"),
    ],
)
def test_refusals(
    cli: Cli, cube: Path, tmp_path: Path, words: tuple[str, ...], code: int, why: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    refused = cli("view", cube, *words, "--json")
    assert refused.code == code
    assert why in refused.object["error"]["message"]
    assert cli("view", tmp_path / "nothing").code == 4
