"""Cubes in an S3-compatible object store: the same dataset, and errors that tell no secrets."""

from __future__ import annotations

import json
import pickle
import re
import traceback
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import scanhsi
from scanhsi import clock
from scanhsi.cli import run
from scanhsi.cube.layout import CubeSpec
from scanhsi.cube.reader import cube_summary, open_cube, read_records
from scanhsi.devices.errors import CubeError, NotACube
from support.cubes import whole, write_cube
from support.seaweed import KEY, S3, SECRET, seaweed, settings

SPEC = CubeSpec(23, 40, 33, "uint16", 12, {"simulated": True}, np.linspace(400, 790, 40))


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[S3]:
    with seaweed(tmp_path_factory.mktemp("s3") / "server") as running:
        yield running


@pytest.fixture(scope="module")
def cube(server: S3, tmp_path_factory: pytest.TempPathFactory) -> str:
    """URL of a cube of which 21 of 23 lines were taken, one of them lost."""
    path = tmp_path_factory.mktemp("cube") / "cube.zarr"
    clock.run(write_cube(path, SPEC, reach=21, missing={4: "lost"}, lines_per_shard=4), virtual=True)
    return server.upload(path, "runs/monday.zarr")


@pytest.fixture
def environment(server: S3, monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    for name, value in server.environment.items():
        monkeypatch.setenv(name, value)
    return monkeypatch


@pytest.mark.parametrize("chunks", ["auto", None])
def test_reads_as_from_a_folder(cube: str, environment: None, chunks: None) -> None:
    dataset = open_cube(cube, chunks=chunks)
    expected = whole(SPEC, 21)
    expected[:, 4] = 0
    np.testing.assert_array_equal(dataset["cube"].values, expected)
    np.testing.assert_array_equal(dataset["cube"].sel(wavelength=503, method="nearest").values, expected[10])
    np.testing.assert_array_equal(dataset["cube"].isel(line=7, sample=3).values, expected[:, 7, 3])
    assert dataset.attrs["lines_missing"] == 1


def test_records_and_summary(cube: str, environment: None) -> None:
    assert read_records(cube).missing == {4: "lost"}
    summary = cube_summary(cube)
    assert (summary.path, summary.lines_stored) == (cube, 20)
    assert summary.size_bytes > 20_000


def test_options_instead_of_the_environment(cube: str, server: S3, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in server.environment:
        monkeypatch.delenv(name, raising=False)
    dataset = open_cube(cube, storage_options=settings(server))
    np.testing.assert_array_equal(dataset["cube"].isel(line=20).values, whole(SPEC, 21)[:, 20])


def test_other_processes_get_the_place_and_no_secret(cube: str, environment: None) -> None:
    sent = pickle.dumps(open_cube(cube)["cube"])
    assert SECRET.encode() not in sent
    np.testing.assert_array_equal(pickle.loads(sent).isel(line=0).values, whole(SPEC, 21)[:, 0])


def test_the_example_of_the_documentation(cube: str, environment: None) -> None:
    page = Path(__file__).parents[2] / "docs/how-to/read-a-cube.md"
    (example,) = re.findall(r"^```py\n(.*?)^```", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    assert f'"{cube}"' in example
    names: dict[str, Any] = {"scanhsi": scanhsi}
    exec(example, names)
    assert names["cube"].sizes["line"] == 21


def test_commands_take_the_url(
    cube: str, environment: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["info", cube, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["path"] == cube
    assert run(["trace", cube, "-o", str(tmp_path / "trace.json")]) == 0
    assert "monday.zarr" in (tmp_path / "trace.json").read_text()


def tell(error: BaseException) -> str:
    return "".join(traceback.format_exception(error))


def test_nothing_there(cube: str, environment: None) -> None:
    with pytest.raises(NotACube, match=r"there is no s3://cubes/runs/tuesday\.zarr"):
        open_cube("s3://cubes/runs/tuesday.zarr")


def test_refused(cube: str, environment: pytest.MonkeyPatch) -> None:
    environment.setenv("AWS_SECRET_ACCESS_KEY", wrong := "wrong-secret-of-mine")
    with pytest.raises(CubeError, match="refuses to let us read s3://cubes/runs/monday") as caught:
        open_cube(cube)
    assert wrong not in tell(caught.value)
    assert KEY not in tell(caught.value)


def test_gone_while_open(cube: str, environment: pytest.MonkeyPatch) -> None:
    """Errors of reading pixels later are ours, too."""
    dataset = open_cube(cube, chunks=None)
    environment.setenv("AWS_SECRET_ACCESS_KEY", wrong := "wrong-secret-of-mine")
    with pytest.raises(CubeError, match="refuses") as caught:
        dataset["cube"].load()
    assert wrong not in tell(caught.value)


def test_no_server(cube: str, environment: pytest.MonkeyPatch) -> None:
    environment.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:9")
    with pytest.raises(CubeError, match="no connection to the server.*AWS_ENDPOINT_URL") as caught:
        open_cube(cube)
    assert SECRET not in tell(caught.value)


@pytest.mark.parametrize("url", ["s3://me:geheim@cubes/a.zarr", "s3://cubes/a.zarr?token=geheim", "s3://geheim@c/a"])
def test_secrets_in_urls_are_refused_and_not_repeated(url: str) -> None:
    with pytest.raises(CubeError, match="credentials in the environment") as caught:
        open_cube(url)
    assert "geheim" not in str(caught.value)


def test_options_that_nobody_knows_are_named_without_their_values() -> None:
    with pytest.raises(CubeError, match=r"obstore cannot use s3://cubes/a\.zarr.*\['secret_accesskey'\]") as caught:
        open_cube("s3://cubes/a.zarr", storage_options={"secret_accesskey": "geheim"})
    assert "geheim" not in str(caught.value)
