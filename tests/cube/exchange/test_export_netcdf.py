"""NetCDF exports, opened by h5netcdf, xarray, GDAL and Octave."""

from __future__ import annotations

import json
from pathlib import Path

import h5netcdf
import numpy as np
import pytest
import rasterio
import xarray as xr

from scanhsi import export_cube, open_cube
from support.exports import make_cube, octave, pixels_of

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
WAVELENGTH_NM = np.linspace(400.1, 1000.7, 6)


@pytest.fixture
def exported(tmp_path: Path) -> Path:
    pixels = pixels_of((6, 9, 7), "uint16", 12, saturated=0.2)
    attributes = {"simulated": True, "plan": {"lines": 20, "mode": "stepped"}}
    make_cube(
        tmp_path / "c.zarr",
        pixels,
        missing={2: "no free buffer"},
        planned=20,
        attributes=attributes,
        wavelength_nm=WAVELENGTH_NM,
    )
    done = export_cube(tmp_path / "c.zarr", tmp_path / "c.nc")
    assert done.paths == (tmp_path / "c.nc",)
    return tmp_path / "c.nc"


def test_everything_of_the_cube_is_in_it(exported: Path) -> None:
    before = open_cube(exported.with_name("c.zarr"))
    with xr.open_dataset(exported, engine="h5netcdf") as after:
        assert after["cube"].dtype == np.uint16
        np.testing.assert_array_equal(after["cube"], before["cube"])
        for name in (
            "wavelength",
            "status",
            "time",
            "mirror_step",
            "mirror_angle_rad",
            "exposure_start_ns",
            "stored_ns",
        ):
            np.testing.assert_array_equal(after[name], before[name], err_msg=name)
        assert after["cube"].attrs["valid_max"] == 4095
        assert after.attrs["simulated"] == "true"
        assert json.loads(after.attrs["plan"]) == {"lines": 20, "mode": "stepped"}
        assert json.loads(after.attrs["missing"]) == {"2": "no free buffer"}
        assert after.attrs["Conventions"] == "CF-1.11"


def test_flags_and_compression(exported: Path) -> None:
    expected = (open_cube(exported.with_name("c.zarr"))["cube"].values == 4095).astype(np.uint8)
    expected[:, 2] = 2
    with h5netcdf.File(exported, "r") as file:
        np.testing.assert_array_equal(file["quality"][...], expected)
        assert file["quality"].attrs["flag_meanings"] == "good saturated missing"
        np.testing.assert_array_equal(file["quality"].attrs["flag_values"], [0, 1, 2])
        np.testing.assert_array_equal(file["status"][...], [1, 1, 2, 1, 1, 1, 1, 1, 1])
        assert file["status"].attrs["flag_meanings"] == "not_stored stored missing"
        assert file["cube"].chunks[1] <= 4
        assert file["cube"].compression == "gzip"


def test_gdal(exported: Path) -> None:
    # Without the option GDAL takes the line of the smallest number for the lowest one, and turns the picture over.
    with rasterio.Env(GDAL_NETCDF_BOTTOMUP="NO"), rasterio.open(f"netcdf:{exported}:cube") as raster:
        np.testing.assert_array_equal(raster.read(), open_cube(exported.with_name("c.zarr"))["cube"].values)


def test_octave(exported: Path) -> None:
    pixels = open_cube(exported.with_name("c.zarr"))["cube"].values
    told = octave(
        "s = load('c.nc'); disp(class(s.cube)); disp(size(s.cube)); printf('%d ', s.cube(:)); printf('\\n');"
        "printf('%.17g ', s.wavelength);",
        exported.parent,
    ).splitlines()
    assert told[0] == "uint16"
    assert told[1].split() == ["7", "9", "6"]  # it reverses the axes: (sample, line, band)
    np.testing.assert_array_equal(np.array(told[2].split(), int), pixels.ravel())
    assert [float(word) for word in told[3].split()] == WAVELENGTH_NM.tolist()


def test_reflectance(tmp_path: Path) -> None:
    pixels = pixels_of((3, 4, 5), "float32", None)
    export_cube(make_cube(tmp_path / "c.zarr", pixels, bits=None), tmp_path / "c.nc")
    with xr.open_dataset(tmp_path / "c.nc", engine="h5netcdf") as after:
        np.testing.assert_array_equal(after["cube"], pixels)
        assert not after["quality"].any()
