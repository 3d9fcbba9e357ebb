"""What `open_cube` promises beside the pixels: chunks, coordinates, prefixes, places, errors."""

from __future__ import annotations

import importlib.util
import pickle
import warnings
from pathlib import Path
from typing import Any

import dask
import numpy as np
import pytest
import zarr
from zarr.storage import MemoryStore

import scanhsi.cube.stored as stored
from scanhsi import clock
from scanhsi.cube.conventions import X_ATTRIBUTES, Y_ATTRIBUTES
from scanhsi.cube.layout import CubeSpec
from scanhsi.cube.reader import cube_summary, open_cube, read_records, shard_chunks
from scanhsi.devices.errors import CubeError
from support.cubes import whole, write_cube

SPEC = CubeSpec(23, 40, 33, "uint16", 12, {"simulated": True}, np.linspace(400, 790, 40))


@pytest.fixture(scope="module")
def cube(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("reader") / "cube.zarr"
    clock.run(write_cube(path, SPEC, lines_per_shard=4), virtual=True)
    return path


@pytest.fixture(params=["tensorstore", "zarr"])
def library(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """What reads the pixels."""
    if request.param == "zarr":
        find_spec = importlib.util.find_spec
        monkeypatch.setattr(stored, "find_spec", lambda name: None if name == "tensorstore" else find_spec(name))
        monkeypatch.setattr(stored, "_tensorstore_reader", None)
    return request.param


def test_dask_chunks_are_whole_shards(cube: Path) -> None:
    lines = open_cube(cube)["cube"].chunksizes["line"]
    assert sum(lines) == 23
    assert all(length % 4 == 0 for length in lines[:-1])
    assert open_cube(cube)["cube"].chunksizes["band"] == (40,)
    assert open_cube(cube, chunks={"line": 8})["cube"].chunksizes["line"] == (8, 8, 7)
    plain = open_cube(cube, chunks=None)["cube"]
    assert plain.chunks is None
    assert not plain.variable._in_memory  # nothing was read


@pytest.mark.parametrize(
    ("shape", "chunk", "shard", "expected"),
    [
        pytest.param((1088, 1200, 1200), (32, 16, 400), (1088, 16, 1200), (1088, 16, 1200), id="one-shard"),
        pytest.param((217, 1200, 1200), (31, 16, 400), (217, 16, 1200), (217, 112, 1200), id="many-small-shards"),
        pytest.param((1088, 1200, 2048), (16, 32, 512), (1088, 64, 2048), (272, 64, 2048), id="part-of-a-big-shard"),
        pytest.param((1088, 1200, 1200), (1088, 16, 1200), None, (1088, 16, 1200), id="chunks-without-shards"),
    ],
)
def test_pieces_of_work_are_neither_tiny_nor_huge(shape: Any, chunk: Any, shard: Any, expected: Any) -> None:
    array = zarr.create_array(MemoryStore(), shape=shape, dtype="uint16", chunks=chunk, shards=shard)
    assert tuple(shard_chunks(array).values()) == expected


INDEXES: list[dict[str, Any]] = [
    {"band": 7},
    {"line": -1, "sample": -33},
    {"line": slice(5, 3)},
    {"line": slice(1, 23, 5), "band": slice(None, None, -1)},
    {"sample": slice(-4, None), "line": slice(20, 99)},
    {"band": [39, 0, -2]},
    {"band": np.array([3, 3, 1]), "sample": [5, 2], "line": 6},
    {"line": np.arange(23) % 2 == 0},
]


@pytest.mark.parametrize("index", INDEXES, ids=str)
@pytest.mark.parametrize("chunks", ["auto", None])
def test_any_index_reads_what_numpy_would(cube: Path, library: str, chunks: Any, index: dict[str, Any]) -> None:
    import xarray as xr

    expected = xr.DataArray(whole(SPEC, 23), dims=("band", "line", "sample")).isel(index)
    np.testing.assert_array_equal(open_cube(cube, chunks=chunks)["cube"].isel(index).values, expected.values)


def test_pointwise_index(cube: Path, library: str) -> None:
    import xarray as xr

    places = {"line": xr.DataArray([1, 22], dims="p"), "sample": xr.DataArray([0, 32], dims="p")}
    spectra = open_cube(cube, chunks=None)["cube"].isel(places)
    np.testing.assert_array_equal(spectra.transpose("p", "band").values, whole(SPEC, 23)[:, [1, 22], [0, 32]].T)


def test_wavelength_selects_on_the_band(cube: Path) -> None:
    pixels = open_cube(cube)["cube"]
    near = pixels.sel(wavelength=503, method="nearest")
    assert float(near["wavelength"]) == 500
    np.testing.assert_array_equal(near.values, whole(SPEC, 23)[10])
    visible = pixels.sel(wavelength=slice(500, 600))
    np.testing.assert_array_equal(visible["band"].values, np.arange(10, 21))
    rgb = open_cube(cube, chunks=None)["cube"].sel(wavelength=[650, 550, 450], method="nearest")
    np.testing.assert_array_equal(rgb.values, whole(SPEC, 23)[[25, 15, 5]])


def test_millimetres_are_coordinates_where_the_cube_has_them(tmp_path: Path) -> None:
    path = tmp_path / "cube.zarr"
    clock.run(write_cube(path, SPEC, reach=9, lines_per_shard=4), virtual=True)
    group = zarr.open_group(path, mode="r+")
    x, y = np.linspace(-8, 8, 33), np.linspace(3, 0.6, 9)
    group.create_array("x", data=x, dimension_names=("sample",), attributes=dict(X_ATTRIBUTES))
    group.create_array("y", data=y, dimension_names=("line",), attributes=dict(Y_ATTRIBUTES))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", zarr.errors.ZarrUserWarning)
        zarr.consolidate_metadata(path)
    pixels = open_cube(path)["cube"]
    assert pixels["x"].attrs["units"] == "mm"
    spot = pixels.sel(x=7.9, y=2.1, method="nearest")
    np.testing.assert_array_equal(spot.values, whole(SPEC, 9)[:, 3, 32])


def test_the_same_lines_have_the_same_name_in_every_process(cube: Path) -> None:
    first, second = open_cube(cube)["cube"], open_cube(cube)["cube"]
    assert first.data.name == second.data.name
    copy = pickle.loads(pickle.dumps(first))
    np.testing.assert_array_equal(copy.isel(line=3).values, whole(SPEC, 23)[:, 3])


def test_computes_in_other_processes(cube: Path) -> None:
    with dask.config.set(scheduler="processes", num_workers=2):
        total = open_cube(cube, chunks={"line": 12})["cube"].sum().values
    assert total == whole(SPEC, 23).sum()


def set_status(path: Path, line: int, status: int) -> None:
    with (path / "status/c" / str(line // 4)).open("r+b") as file:
        file.seek(line % 4)
        file.write(bytes([status]))


def test_a_hole_ends_a_cube_that_is_not_closed(tmp_path: Path) -> None:
    """What lies behind it may be written anew."""

    async def abandon(path: Path) -> None:
        from scanhsi.cube.records import LineRecords
        from scanhsi.cube.writer import CubeWriter
        from support.cubes import feed

        records = LineRecords(SPEC.lines)
        writer = CubeWriter(path, SPEC, lines_per_shard=4)
        await writer.open(records)
        await feed(writer, SPEC, records, range(12), {2: "lost"})
        await writer.flush()

    path = tmp_path / "cube.zarr"
    clock.run(abandon(path), virtual=True)
    assert open_cube(path).sizes["line"] == 12
    set_status(path, 6, 0)
    assert open_cube(path).sizes["line"] == read_records(path).lines == cube_summary(path).shape[1] == 6
    set_status(path, 0, 0)
    assert open_cube(path).sizes["line"] == 0
    assert open_cube(path)["cube"].values.shape == (40, 0, 33)


def test_a_hole_in_a_closed_cube_is_damage_and_hides_nothing(tmp_path: Path) -> None:
    path = tmp_path / "cube.zarr"
    clock.run(write_cube(path, SPEC, reach=12, lines_per_shard=4), virtual=True)
    set_status(path, 6, 0)
    dataset = open_cube(path)
    assert dataset.sizes["line"] == 12
    assert dataset.attrs["lines_stored"] == 11
    assert dataset["status"].values[6] == 0


def test_a_torn_shard_is_an_error_that_says_where(tmp_path: Path, library: str) -> None:
    path = tmp_path / "cube.zarr"
    clock.run(write_cube(path, SPEC, lines_per_shard=4), virtual=True)
    shard = path / "cube/c/0/2/0"
    shard.write_bytes(shard.read_bytes()[:-100])
    dataset = open_cube(path)
    with pytest.raises(CubeError, match=r"'cube' of .*cube\.zarr cannot be read.*scanhsi verify"):
        dataset["cube"].isel(line=9).load()
    np.testing.assert_array_equal(dataset["cube"].isel(line=3).values, whole(SPEC, 23)[:, 3])


def test_file_urls_are_paths(cube: Path) -> None:
    assert open_cube(f"file://{cube}").sizes["line"] == 23
    with pytest.raises(CubeError, match="storage_options are for URLs"):
        open_cube(cube, storage_options={"region": "x"})
