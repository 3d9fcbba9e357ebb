"""Options of ``scanhsi scan`` about how the cube is stored."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from scanhsi.cube.reader import open_cube
from support.command_line import Cli


def test_binned_raw_and_synced_at_close(cli: Cli, mini: Path, tmp_path: Path) -> None:
    """The sums are those of the same scan unbinned."""
    plain, binned = tmp_path / "plain.zarr", tmp_path / "binned.zarr"
    assert cli("scan", mini, "-o", plain, "--virtual").code == 0
    options = ("--bin-bands", 3, "--bin-samples", 2, "--raw", "--durability", "at close")
    assert cli("scan", mini, "-o", binned, "--virtual", *options).code == 0
    dataset = open_cube(binned)
    assert dataset.attrs["storage"] == {"codec": "raw", "durability": "at close"}
    assert dataset.attrs["binning"] == {"bands": 3, "samples": 2, "operation": "sum"}
    pixels = open_cube(plain)["cube"].values.astype(np.int64)
    assert pixels.shape == (8, 6, 16)
    np.testing.assert_array_equal(dataset["cube"].values, pixels[:6].reshape(2, 3, 6, 8, 2).sum(axis=(1, 4)))


def test_a_picture_comes_beside_the_cube(cli: Cli, mini: Path, tmp_path: Path) -> None:
    assert cli("scan", mini, "-o", tmp_path / "a.zarr", "--virtual", "--codec", "zstd").code == 0
    assert (tmp_path / "a.zarr/quicklook/c/0/0/0").exists()
    assert cli("scan", mini, "-o", tmp_path / "b.zarr", "--virtual", "--set", "storage.quicklook=false").code == 0
    assert not (tmp_path / "b.zarr/quicklook").exists()


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (("--raw", "--codec", "lz4"), "--raw is a codec of its own"),
        (("--codec", "gzip"), "storage.codec"),
        (("--durability", "never"), "storage.durability"),
        (("--bin-bands", "0"), "storage.bin_bands"),
        (("--bin-bands", "many"), "storage.bin_bands"),
        (("--bin-bands", "9"), "bins of 9 bands and 1 samples exceed the frame"),
    ],
)
def test_refused(cli: Cli, mini: Path, tmp_path: Path, options: tuple[str, ...], text: str) -> None:
    refused = cli("scan", mini, "-o", tmp_path / "a.zarr", "--virtual", *options)
    assert refused.code == 2
    assert text in " ".join(refused.err.split())
    assert not (tmp_path / "a.zarr").exists()
