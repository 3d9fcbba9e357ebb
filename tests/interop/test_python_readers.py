"""Cubes open without scanhsi: zarr-python, xarray, tensorstore, dask."""

from __future__ import annotations

import dask.array
import numpy as np
import tensorstore
import xarray as xr
import zarr

import scanhsi
from support.interop import Written


def test_zarr_python(written: Written) -> None:
    group = zarr.open_group(written.path, mode="r")
    for name, expected in (
        ("cube", written.pixels),
        ("wavelength", written.wavelength),
        ("status", written.status),
        ("time", written.time_ns),
    ):
        np.testing.assert_array_equal(np.asarray(group[name][...]), expected)
    np.testing.assert_array_equal(dask.array.from_zarr(written.path, "cube")[:, 5].compute(), written.pixels[:, 5])


def test_xarray(written: Written) -> None:
    for consolidated in (True, False):
        dataset = xr.open_zarr(written.path, chunks=None, consolidated=consolidated)
        assert dataset["cube"].dims == ("band", "line", "sample")
        np.testing.assert_array_equal(dataset["cube"].values, written.pixels)
        np.testing.assert_array_equal(dataset["wavelength"].values, written.wavelength)
        np.testing.assert_array_equal(dataset["status"].values, written.status)
        np.testing.assert_array_equal(dataset["time"].values.astype(np.int64), written.time_ns)


def test_tensorstore(written: Written) -> None:
    def read(name: str) -> np.ndarray:
        spec = {"driver": "zarr3", "kvstore": {"driver": "file", "path": f"{written.path}/{name}/"}}
        return tensorstore.open(spec, read=True).result().read().result()

    np.testing.assert_array_equal(read("cube"), written.pixels)
    np.testing.assert_array_equal(read("wavelength"), written.wavelength)
    np.testing.assert_array_equal(read("status"), written.status)
    np.testing.assert_array_equal(read("time"), written.time_ns)


def test_ours(written: Written) -> None:
    dataset = scanhsi.open_cube(written.path)
    np.testing.assert_array_equal(dataset["cube"].values, written.pixels)
    np.testing.assert_array_equal(dataset["wavelength"].values, written.wavelength)
    np.testing.assert_array_equal(dataset["status"].values, written.status)
    np.testing.assert_array_equal(dataset["time"].values.astype(np.int64), written.time_ns)
