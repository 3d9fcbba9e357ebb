"""The picture that is written beside a cube while it is scanned."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr

from scanhsi import clock
from scanhsi.calibration.online import online_quicklook
from scanhsi.cube.binning import Binning
from scanhsi.cube.layout import CubeSpec
from scanhsi.cube.quicklook import QuicklookScale, QuicklookSpec
from scanhsi.cube.records import LineRecords
from scanhsi.cube.writer import CubeWriter
from support.cubes import feed, whole, write_cube

WEIGHTS = np.stack([np.eye(6)[5], np.full(6, 1 / 6), np.eye(6)[0]])


def picture_of(path: Path) -> Any:
    array = zarr.open_group(path, mode="r")["quicklook"]
    assert isinstance(array, zarr.Array)
    return array


@pytest.mark.parametrize("lines_per_shard", [16, 12, 5])
def test_pixels_are_weighted_means(tmp_path: Path, lines_per_shard: int) -> None:
    spec = CubeSpec(29, 6, 21, "uint16", 12, quicklook=QuicklookSpec(WEIGHTS))
    clock.run(
        write_cube(tmp_path / "c", spec, lines_per_shard=lines_per_shard, missing={1: "lost", 28: "lost"}), virtual=True
    )
    array = picture_of(tmp_path / "c")
    lines = QuicklookScale.choose(lines_per_shard, spec.binning).lines
    assert lines == {16: 8, 12: 6, 5: 5}[lines_per_shard] == array.attrs["lines_per_pixel"]
    rows = -(-29 // lines)
    assert array.shape == (3, rows, 3)
    values = np.einsum("cb,bls->cls", WEIGHTS, whole(spec, 29)[:, :, ::8])
    for row in range(rows):
        there = [line for line in range(row * lines, min(29, (row + 1) * lines)) if line not in (1, 28)]
        expected = values[:, there].mean(axis=1) if there else 0
        np.testing.assert_allclose(array[:, row], expected, atol=0.51)


def test_a_picture_is_of_the_lines_reached_and_of_binned_pixels(tmp_path: Path) -> None:
    spec = CubeSpec(40, 6, 32, "uint16", 12, binning=Binning(2, 2), quicklook=QuicklookSpec(np.full((3, 6), 1 / 6)))
    clock.run(write_cube(tmp_path / "c", spec, reach=17, lines_per_shard=8), virtual=True)
    array = picture_of(tmp_path / "c")
    assert array.shape == (3, 3, 4)
    pairs = whole(spec, 8).reshape(6, 8, 16, 2).mean(axis=(0, 1, 3))[::4]
    np.testing.assert_allclose(array[0, 0], pairs, atol=0.51)


def test_it_is_written_before_the_status(tmp_path: Path) -> None:
    spec = CubeSpec(16, 6, 9, "uint16", 12, quicklook=QuicklookSpec(WEIGHTS))

    async def main() -> None:
        records = LineRecords(16)
        writer = CubeWriter(tmp_path / "c", spec, lines_per_shard=8)
        await writer.open(records)
        await feed(writer, spec, records, range(8), {})
        await writer.flush()
        assert picture_of(tmp_path / "c")[:, 0].all()
        await writer.close()

    clock.run(main(), virtual=True)


def test_colours_of_a_flat_spectrum_are_grey() -> None:
    for wavelength in (np.linspace(380, 1000, 300), None, np.linspace(1000, 2000, 300)):
        spec = online_quicklook(300, wavelength)
        np.testing.assert_allclose(spec.weights.sum(axis=1), 1, atol=2e-3)
    red = online_quicklook(300, np.linspace(400, 700, 300)).weights @ (np.linspace(400, 700, 300) > 620)
    assert red[0] > 0.4 > abs(red[2])
    third = online_quicklook(3, None).weights
    np.testing.assert_array_equal(third, np.eye(3)[::-1])
    assert online_quicklook(2, None).weights.shape == (3, 2)
