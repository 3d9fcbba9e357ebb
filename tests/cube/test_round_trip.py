"""What goes into a cube comes out of it, to every reader."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
import zarr

from scanhsi import clock
from scanhsi.cube.layout import CubeSpec
from scanhsi.cube.reader import cube_summary, open_cube, read_records
from scanhsi.cube.records import NOT_STAMPED, STAGES
from support.cubes import whole, write_cube

SIZES = [
    pytest.param((40, 33, 50), 8, id="not-multiples"),
    pytest.param((16, 32, 16), 8, id="multiples"),
    pytest.param((1, 1, 1), None, id="one-pixel"),
    pytest.param((5, 70, 3), None, id="default-shards"),
    pytest.param((53, 9, 811), 4, id="prime-sizes-need-padding"),
]


@pytest.mark.parametrize("dtype", ["uint8", "uint16"])
@pytest.mark.parametrize(("shape", "lines_per_shard"), SIZES)
def test_bit_exact_to_every_reader(
    tmp_path: Path, dtype: str, shape: tuple[int, int, int], lines_per_shard: int | None
) -> None:
    bands, lines, samples = shape
    spec = CubeSpec(lines, bands, samples, dtype, 8 if dtype == "uint8" else 12)
    path = tmp_path / "cube.zarr"
    clock.run(write_cube(path, spec, lines_per_shard=lines_per_shard), virtual=True)
    expected = whole(spec, lines)
    plain = zarr.open_group(path, mode="r")["cube"]
    assert isinstance(plain, zarr.Array)
    assert plain.dtype == dtype
    np.testing.assert_array_equal(np.asarray(plain[:]), expected)
    np.testing.assert_array_equal(xr.open_zarr(path, chunks=None)["cube"].values, expected)
    np.testing.assert_array_equal(open_cube(path)["cube"].values, expected)


@pytest.mark.parametrize("codec", ["zstd", "none"])
def test_other_codecs(tmp_path: Path, codec: Any) -> None:
    from scanhsi.cube.records import LineRecords
    from scanhsi.cube.writer import CubeWriter
    from support.cubes import feed

    spec = CubeSpec(10, 6, 7, "uint16", 12)

    async def main() -> None:
        records = LineRecords(spec.lines)
        writer = CubeWriter(tmp_path / "cube.zarr", spec, lines_per_shard=4, codec=codec)
        await writer.open(records)
        await feed(writer, spec, records, range(10), {})
        await writer.close()

    clock.run(main(), virtual=True)
    np.testing.assert_array_equal(open_cube(tmp_path / "cube.zarr")["cube"].values, whole(spec, 10))


def test_black_lines_are_stored_too(tmp_path: Path) -> None:
    """All-zero chunks must exist on disk, or nothing would tell them from a lost file."""
    spec = CubeSpec(4, 3, 5, "uint8", 8)

    async def main() -> None:
        from scanhsi.cube.records import LineRecords
        from scanhsi.cube.writer import CubeWriter

        records = LineRecords(4)
        writer = CubeWriter(tmp_path / "cube.zarr", spec, lines_per_shard=2)
        await writer.open(records)
        for line in range(4):
            buffer = writer.buffer(line)
            assert buffer is not None
            buffer[:] = 0
            await writer.append(line)
        await writer.close()

    clock.run(main(), virtual=True)
    assert len([file for file in (tmp_path / "cube.zarr/cube/c").rglob("*") if file.is_file()]) == 2


def test_records_and_attributes(tmp_path: Path) -> None:
    wavelength = np.linspace(400, 1000, 6)
    attributes = {"plan": {"lines": 11, "mode": "stepped"}, "simulated": True, "versions": {"scanhsi": "0"}}
    spec = CubeSpec(11, 6, 4, "uint16", 12, attributes, wavelength)
    path = tmp_path / "cube.zarr"
    offset = 1_700_000_000_000_000_000
    records = clock.run(write_cube(path, spec, lines_per_shard=4, clock_offset_ns=offset), virtual=True)
    dataset = open_cube(path)
    assert dataset["cube"].dims == ("band", "line", "sample")
    assert dataset.attrs["plan"] == attributes["plan"]
    assert dataset.attrs["simulated"] is True
    assert dataset.attrs["complete"] is True
    assert dataset["cube"].attrs["valid_max"] == 4095
    np.testing.assert_array_equal(dataset["time"].values.astype("int64"), records.stamps["exposure_start"] + offset)
    nearest = dataset["cube"].sel(wavelength=520, method="nearest")
    assert float(nearest["wavelength"]) == 520
    np.testing.assert_array_equal(nearest.values, whole(spec, 11)[1])

    back = read_records(path)
    for stage in STAGES:
        np.testing.assert_array_equal(back.stamps[stage], records.stamps[stage])
    assert (back.stamps["stored"] != NOT_STAMPED).all()
    for name in ("status", "mirror_step", "mirror_angle_rad", "frame_id", "device_ns", "smeared"):
        np.testing.assert_array_equal(getattr(back, name), getattr(records, name))
    assert back.stored == 11


def test_missing_lines_keep_their_place_and_reason(tmp_path: Path) -> None:
    spec = CubeSpec(13, 5, 6, "uint16", 12)
    missing = {1: "3 packets missing", 7: "no free buffer", 12: "timeout"}
    path = tmp_path / "cube.zarr"
    clock.run(write_cube(path, spec, missing=missing, lines_per_shard=4), virtual=True)
    dataset = open_cube(path)
    expected = whole(spec, 13)
    expected[:, list(missing), :] = 0
    np.testing.assert_array_equal(dataset["cube"].values, expected)
    assert list(np.flatnonzero(dataset["status"] == 2)) == list(missing)
    assert np.isnat(dataset["time"].values[7])
    summary = cube_summary(path)
    assert summary.missing_reasons == missing == read_records(path).missing
    assert (summary.lines_planned, summary.lines_stored, summary.lines_missing) == (13, 10, 3)
    assert summary.complete
    assert summary.attributes["acquisition"]["lines_missing"] == 3


@pytest.mark.parametrize("reach", [0, 1, 4, 6])
def test_short_scan_is_a_shorter_cube(tmp_path: Path, reach: int) -> None:
    spec = CubeSpec(9, 5, 6, "uint8", 8, {"simulated": False})
    path = tmp_path / "cube.zarr"
    clock.run(write_cube(path, spec, reach=reach, lines_per_shard=4), virtual=True)
    for dataset in (
        open_cube(path),
        xr.open_zarr(path, chunks=None),
        xr.open_zarr(path, chunks=None, consolidated=False),
    ):
        assert dataset.sizes["line"] == reach
        np.testing.assert_array_equal(dataset["cube"].values, whole(spec, 9)[:, :reach])
    summary = cube_summary(path)
    assert not summary.complete
    assert summary.simulated is False
    assert (summary.lines_planned, summary.lines_stored, summary.shape) == (9, reach, (5, reach, 6))
