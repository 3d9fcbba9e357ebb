"""ENVI exports: values and wavelengths as `spectral` and GDAL see them; the body of a BIL is the stream of frames."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest
import rasterio
import spectral.io.envi

from scanhsi import export_cube
from support.exports import make_cube, needed, pixels_of

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
WAVELENGTH_NM = np.linspace(400.1, 1000.7, 7)
KINDS = [
    pytest.param("uint8", 8, (7, 11, 9), id="8-bit"),
    pytest.param("uint16", 12, (7, 11, 9), id="12-bit"),
    pytest.param("uint16", 16, (7, 11, 9), id="16-bit"),
    pytest.param("uint32", 18, (7, 11, 9), id="sums"),
    pytest.param("float32", None, (7, 11, 9), id="reflectance"),
    pytest.param("uint16", 12, (1, 11, 9), id="one-band"),
    pytest.param("uint16", 12, (7, 1, 9), id="one-line"),
    pytest.param("uint16", 12, (1, 1, 1), id="one-pixel"),
]


@pytest.mark.parametrize(("dtype", "bits", "shape"), KINDS)
def test_the_body_of_a_bil_is_the_stream_of_frames(
    tmp_path: Path, dtype: str, bits: int | None, shape: tuple[int, int, int]
) -> None:
    pixels = pixels_of(shape, dtype, bits)
    done = export_cube(make_cube(tmp_path / "c.zarr", pixels, bits=bits), tmp_path / "c.bil")
    assert done.paths == (tmp_path / "c.hdr", tmp_path / "c.bil")
    frames = b"".join(pixels[:, line].astype(pixels.dtype.newbyteorder("<")).tobytes() for line in range(shape[1]))
    assert (tmp_path / "c.bil").read_bytes() == frames


@pytest.mark.parametrize(("dtype", "bits", "shape"), KINDS)
def test_spectral_and_gdal_see_the_same(
    tmp_path: Path, dtype: str, bits: int | None, shape: tuple[int, int, int]
) -> None:
    pixels = pixels_of(shape, dtype, bits)
    wavelength_nm = WAVELENGTH_NM[: shape[0]]
    cube = make_cube(tmp_path / "c.zarr", pixels, bits=bits, wavelength_nm=wavelength_nm)
    for interleave in ("bil", "bsq", "bip"):
        export_cube(cube, tmp_path / f"{interleave}.hdr", interleave=interleave)
        check(tmp_path / f"{interleave}.{interleave}", pixels, bits, wavelength_nm)


def check(body: Path, pixels: np.ndarray, bits: int | None, wavelength_nm: np.ndarray) -> None:
    image = spectral.io.envi.open(str(body.with_suffix(".hdr")))
    np.testing.assert_array_equal(np.asarray(image.open_memmap(interleave="bsq")), pixels)
    assert image.bands.centers == wavelength_nm.tolist()
    assert image.bands.band_unit == "Nanometers"
    with rasterio.open(body) as raster:
        np.testing.assert_array_equal(raster.read(), pixels)
        assert [float(raster.tags(band + 1)["wavelength"]) for band in range(len(pixels))] == wavelength_nm.tolist()
        nodata = raster.nodata
    assert np.isnan(nodata) if bits is None else nodata == 2**bits - 1


def test_as_many_bands_as_a_sensor_has_rows(tmp_path: Path) -> None:
    """GDAL gives up on headers with lines of more than 10000 characters, and then knows no wavelength."""
    wavelength_nm = np.linspace(370.123456789, 948.7654321, 1088)
    cube = make_cube(tmp_path / "c.zarr", pixels_of((1088, 2, 3), "uint16", 12), wavelength_nm=wavelength_nm)
    export_cube(cube, tmp_path / "c.bil")
    check(tmp_path / "c.bil", pixels_of((1088, 2, 3), "uint16", 12), 12, wavelength_nm)
    told = subprocess.run(
        [needed("gdalinfo", "gdal-bin"), "c.bil"], cwd=tmp_path, check=True, capture_output=True, text=True, timeout=60
    )
    assert told.stderr == ""
    told_nm = [float(line.split("=")[1]) for line in told.stdout.splitlines() if line.startswith("    wavelength=")]
    assert told_nm == wavelength_nm.tolist()


def test_gdal_itself_translates_it(tmp_path: Path) -> None:
    """The program of the distribution, another version than the one in the wheel."""
    pixels = pixels_of((5, 6, 7), "uint16", 12)
    export_cube(make_cube(tmp_path / "c.zarr", pixels), tmp_path / "c.bil")
    command = [needed("gdal_translate", "gdal-bin"), "-q", "-of", "GTiff", "c.bil", "c.tif"]
    subprocess.run(command, cwd=tmp_path, check=True, timeout=60)
    with rasterio.open(tmp_path / "c.tif") as raster:
        np.testing.assert_array_equal(raster.read(), pixels)


def test_one_value_marks_missing_lines_and_saturated_pixels(tmp_path: Path) -> None:
    pixels = pixels_of((4, 10, 6), "uint16", 12, saturated=0.3)
    cube = make_cube(tmp_path / "c.zarr", pixels, missing={0: "lost", 9: "lost"})
    done = export_cube(cube, tmp_path / "c.bsq")
    assert done.missing == 2
    assert any("2 of 10 lines are missing" in note for note in done.notes)
    with rasterio.open(tmp_path / "c.bsq") as raster:
        masked = raster.read(masked=True)
    expected = pixels == 4095
    expected[:, [0, 9]] = True
    np.testing.assert_array_equal(np.ma.getmaskarray(masked), expected)
    np.testing.assert_array_equal(masked.data[~expected], pixels[~expected])


def test_missing_lines_of_reflectance_are_nan(tmp_path: Path) -> None:
    cube = make_cube(tmp_path / "c.zarr", pixels_of((3, 5, 4), "float32", None), bits=None, missing={2: "lost"})
    export_cube(cube, tmp_path / "c.bil")
    with rasterio.open(tmp_path / "c.bil") as raster:
        nan = np.isnan(raster.read())
    assert nan[:, 2].all()
    assert not nan[:, [0, 1, 3, 4]].any()


def test_a_partial_cube_is_exported_as_far_as_it_goes(tmp_path: Path) -> None:
    pixels = pixels_of((4, 6, 5), "uint8", 8)
    done = export_cube(make_cube(tmp_path / "c.zarr", pixels, bits=8, planned=40), tmp_path / "c.bsq")
    assert done.shape == (4, 6, 5)
    assert "the cube is partial: 6 of 40 planned lines were reached" in done.notes
    with rasterio.open(tmp_path / "c.bsq") as raster:
        np.testing.assert_array_equal(raster.read(), pixels)


def test_the_header_says_simulated(tmp_path: Path) -> None:
    cube = make_cube(tmp_path / "{odd}.zarr", pixels_of((2, 2, 2), "uint8", 8), bits=8, attributes={"simulated": True})
    export_cube(cube, tmp_path / "c.raw")
    header = spectral.io.envi.read_envi_header(str(tmp_path / "c.hdr"))
    assert header["scanhsi simulated"] == "true"
    assert header["description"].startswith("SIMULATED (odd).zarr")
