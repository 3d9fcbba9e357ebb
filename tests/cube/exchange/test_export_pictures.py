"""OME-TIFF, PNG and GeoTIFF."""

from __future__ import annotations

import warnings
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import rasterio
import tifffile
import zarr

from scanhsi import ConfigError, export_cube
from support.exports import make_cube, pixels_of

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
WAVELENGTH_NM = np.linspace(400.0, 1000.0, 7)
SPACE = {"ome": "http://www.openmicroscopy.org/Schemas/OME/2016-06"}


@pytest.mark.parametrize(("dtype", "bits"), [("uint8", 8), ("uint16", 12), ("uint32", 20), ("float32", None)], ids=str)
def test_ome_tiff(tmp_path: Path, dtype: str, bits: int | None) -> None:
    pixels = pixels_of((7, 10, 8), dtype, bits)
    cube = make_cube(tmp_path / "c.zarr", pixels, bits=bits, missing={4: "lost"}, wavelength_nm=WAVELENGTH_NM)
    export_cube(cube, tmp_path / "c.ome.tif", bands="800nm,600nm,0")
    expected = pixels[[4, 2, 0]].copy()
    expected[:, 4] = np.nan if bits is None else 2**bits - 1
    with tifffile.TiffFile(tmp_path / "c.ome.tif") as tiff:
        assert tiff.is_ome
        assert tiff.series[0].axes == "CYX"
        np.testing.assert_array_equal(tiff.asarray(), expected)
        root = ElementTree.fromstring(tiff.ome_metadata or "")
    channels = root.findall(".//ome:Channel", SPACE)
    assert [float(channel.attrib["EmissionWavelength"]) for channel in channels] == [800, 600, 400]
    assert [channel.attrib["Name"] for channel in channels] == ["800.0 nm", "600.0 nm", "400.0 nm"]
    marks = {mark.attrib["K"]: mark.text for mark in root.findall(".//ome:M", SPACE)}
    assert marks["missing lines"] == "4"


def test_ome_tiff_of_one_band_and_one_line(tmp_path: Path) -> None:
    pixels = pixels_of((1, 1, 5), "uint8", 8)
    export_cube(make_cube(tmp_path / "c.zarr", pixels, bits=8), tmp_path / "c.ome.tif")
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "c.ome.tif").reshape(1, 1, 5), pixels)


@pytest.mark.parametrize(
    ("dtype", "bits"), [("uint8", 8), ("uint8", 6), ("uint16", 10), ("uint16", 12), ("uint16", 16)]
)
@pytest.mark.parametrize("bands", ["800nm", "800nm,600nm,400nm"])
def test_png_can_be_shifted_back_to_counts(tmp_path: Path, dtype: str, bits: int, bands: str) -> None:
    pixels = pixels_of((7, 9, 8), dtype, bits)
    cube = make_cube(tmp_path / "c.zarr", pixels, bits=bits, missing={4: "lost"}, wavelength_nm=WAVELENGTH_NM)
    export_cube(cube, tmp_path / "c.png", bands=bands)
    chosen = pixels[[4]] if bands == "800nm" else pixels[[4, 2, 0]]
    with rasterio.open(tmp_path / "c.png") as picture:
        values = picture.read()
    top = np.iinfo(dtype).max
    np.testing.assert_array_equal(values[-1, 4], 0)  # transparent
    stored = [line for line in range(9) if line != 4]
    assert (values[-1, stored] == top).all()
    np.testing.assert_array_equal(values[:-1, stored] >> (8 * pixels.itemsize - bits), chosen[:, stored])
    np.testing.assert_array_equal(values[:-1, stored] == top, chosen[:, stored] == 2**bits - 1)


def test_what_a_png_cannot_hold(tmp_path: Path) -> None:
    counts = make_cube(tmp_path / "c.zarr", pixels_of((4, 3, 3), "uint16", 12))
    with pytest.raises(ConfigError, match="1 or 3 bands, not 4"):
        export_cube(counts, tmp_path / "c.png")
    reflectance = make_cube(tmp_path / "r.zarr", pixels_of((1, 3, 3), "float32", None), bits=None)
    with pytest.raises(ConfigError, match="8 or 16 bits a pixel, not float32"):
        export_cube(reflectance, tmp_path / "c.png")


def rectified(path: Path, x: np.ndarray, y: np.ndarray) -> Path:
    """Give a cube coordinates in mm, as rectification does."""
    group = zarr.open_group(path, mode="r+", use_consolidated=False)
    for name, values, dimension in (("x", x, "sample"), ("y", y, "line")):
        group.create_array(
            name, data=values, dimension_names=(dimension,), compressors=None, attributes={"units": "mm"}
        )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # consolidated metadata is not in the specification yet
        zarr.consolidate_metadata(str(path))
    return path


def test_geotiff_of_a_rectified_cube(tmp_path: Path) -> None:
    pixels = pixels_of((7, 10, 8), "uint16", 12)
    cube = make_cube(tmp_path / "c.zarr", pixels, missing={4: "lost"}, wavelength_nm=WAVELENGTH_NM)
    rectified(cube, np.linspace(-3.5, 3.5, 8), np.linspace(20, 2, 10))
    export_cube(cube, tmp_path / "c.tif")
    with rasterio.open(tmp_path / "c.tif") as raster:
        expected = pixels.copy()
        expected[:, 4] = 4095
        np.testing.assert_array_equal(raster.read(), expected)
        assert raster.nodata == 4095
        assert raster.xy(0, 0) == pytest.approx((-3.5, 20))
        assert raster.xy(9, 7) == pytest.approx((3.5, 2))
        assert [float(raster.tags(band)["wavelength"]) for band in raster.indexes] == WAVELENGTH_NM.tolist()


@pytest.mark.parametrize(
    ("y", "why"), [(None, "no coordinate x"), (np.array([0.0, 1.0, 3.0, 4.0]), "not evenly spaced along y")]
)
def test_geotiff_of_another_cube_is_refused(tmp_path: Path, y: np.ndarray | None, why: str) -> None:
    cube = make_cube(tmp_path / "c.zarr", pixels_of((2, 4, 3), "uint8", 8), bits=8)
    if y is not None:
        rectified(cube, np.arange(3.0), y)
    with pytest.raises(ConfigError, match=f"is not rectified: .*{why}"):
        export_cube(cube, tmp_path / "c.tif")
    assert not (tmp_path / "c.tif").exists()
