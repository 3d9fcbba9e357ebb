"""ENVI files of others: every interleave, type and byte order; headers that cannot be read are told by key and line."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import spectral.io.envi

from scanhsi import ConfigError, CubeError, export_cube, import_cube, open_cube
from scanhsi.cube.reader import cube_summary
from scanhsi.cube.verify import verify_cube
from scanhsi.devices.errors import CubeExists
from support.exports import make_cube, pixels_of

SHAPE = (4, 6, 5)
HEADER = """ENVI
; written by hand
description = {
  a field, {not a lawn
}
samples = 5
lines   = 6
bands   = 4
Header Offset = 3
file type = ENVI Standard
data type = 12
interleave = bsq
byte order = 1
wavelength units = Micrometers
wavelength = { 0.4, 0.5,
  0.6, 0.7 }
fwhm = {0.01, 0.01, 0.01, 0.02}
"""


def by_hand(folder: Path, header: str = HEADER, body: bytes | None = None) -> Path:
    pixels = pixels_of(SHAPE, "uint16", 12)
    (folder / "f.hdr").write_text(header)
    (folder / "f.img").write_bytes(b"xyz" + pixels.astype(">u2").tobytes() if body is None else body)
    return folder / "f.hdr"


def test_a_header_by_hand(tmp_path: Path) -> None:
    done = import_cube(by_hand(tmp_path), tmp_path / "c.zarr", significant_bits=12)
    cube = open_cube(tmp_path / "c.zarr")
    np.testing.assert_array_equal(cube["cube"].values, pixels_of(SHAPE, "uint16", 12))
    np.testing.assert_allclose(cube["wavelength"], [400, 500, 600, 700])
    np.testing.assert_allclose(cube.attrs["fwhm_nm"], [10, 10, 10, 20])
    assert (cube["status"].values == 1).all()
    assert cube["cube"].attrs["valid_max"] == 4095
    origin = cube.attrs["imported_from"]
    assert (origin["file"], origin["format"], origin["dtype"]) == ("f.hdr", "ENVI", "uint16")
    assert origin["header"]["description"] == "a field, {not a lawn"
    assert "simulated" not in cube.attrs
    assert cube_summary(tmp_path / "c.zarr").simulated is None
    assert done.notes == ()
    assert done.missing == 0


@pytest.mark.parametrize("interleave", ["bil", "bsq", "bip"])
@pytest.mark.parametrize("byteorder", [0, 1])
@pytest.mark.parametrize("dtype", ["uint8", "int16", "uint16", "uint32", "float32"])
def test_files_of_spectral(tmp_path: Path, interleave: str, byteorder: int, dtype: str) -> None:
    pixels = (pixels_of(SHAPE, "uint8", 8).astype(np.int64) - (100 if dtype == "int16" else 0)).astype(dtype)
    spectral.io.envi.save_image(
        str(tmp_path / "f.hdr"),
        pixels.transpose(1, 2, 0),
        dtype=np.dtype(dtype),
        interleave=interleave,
        byteorder=byteorder,
        metadata={"wavelength": [400.5, 500, 600, 700], "wavelength units": "Nanometers"},
    )
    done = import_cube(tmp_path / "f.img", tmp_path / "c.zarr")
    assert done.dtype == ("float32" if dtype == "int16" else dtype)
    cube = open_cube(tmp_path / "c.zarr")
    np.testing.assert_array_equal(cube["cube"].values, pixels)
    assert cube["wavelength"].values.tolist() == [400.5, 500, 600, 700]


@pytest.mark.parametrize("dtype", ["int32", "float64", "int64", "uint64"])
def test_types_that_no_cube_holds_are_asked_about(tmp_path: Path, dtype: str) -> None:
    pixels = pixels_of(SHAPE, "uint16", 12).astype(dtype)
    spectral.io.envi.save_image(
        str(tmp_path / "f.hdr"), pixels.transpose(1, 2, 0), dtype=np.dtype(dtype), interleave="bil"
    )
    with pytest.raises(ConfigError, match=f"holds {dtype}, which no cube does.*--dtype"):
        import_cube(tmp_path / "f.hdr", tmp_path / "c.zarr")
    done = import_cube(tmp_path / "f.hdr", tmp_path / "c.zarr", dtype="uint16")
    assert done.notes == (f"{dtype} became uint16, every value checked",)
    np.testing.assert_array_equal(open_cube(tmp_path / "c.zarr")["cube"].values, pixels)


@pytest.mark.parametrize("wrong", [-1, 65536, 0.5, np.nan])
def test_values_that_do_not_fit_are_refused_with_their_place(tmp_path: Path, wrong: float) -> None:
    pixels = np.ones(SHAPE)
    pixels[2, 4, 3] = wrong
    spectral.io.envi.save_image(str(tmp_path / "f.hdr"), pixels.transpose(1, 2, 0), dtype=np.float64, interleave="bil")
    with pytest.raises(CubeError, match="line 4, band 2, sample 3"):
        import_cube(tmp_path / "f.hdr", tmp_path / "c.zarr", dtype="uint16")
    assert not [path.name for path in tmp_path.iterdir() if "zarr" in path.name]


def test_lines_of_no_data_are_missing(tmp_path: Path) -> None:
    pixels = np.full(SHAPE, 7, np.int16)
    pixels[:, 2] = -9999
    pixels[0, 3] = -9999
    spectral.io.envi.save_image(
        str(tmp_path / "f.hdr"),
        pixels.transpose(1, 2, 0),
        dtype=np.int16,
        interleave="bil",
        metadata={"data ignore value": -9999},
    )
    done = import_cube(tmp_path / "f.hdr", tmp_path / "c.zarr")
    assert done.missing == 1
    assert cube_summary(tmp_path / "c.zarr").missing_reasons == {2: "every pixel has the data ignore value"}
    assert list(open_cube(tmp_path / "c.zarr")["status"].values) == [1, 1, 2, 1, 1, 1]


@pytest.mark.parametrize(
    ("old", "new", "fragment"),
    [
        ("ENVI\n;", "ENVY\n;", r"f\.hdr, line 1: an ENVI header begins"),
        ("samples = 5\n", "", "no key 'samples': a whole number is needed"),
        ("samples = 5", "samples = five", "line 6: samples = five: a whole number"),
        ("lines   = 6", "lines   = 0", "line 7: lines = 0: at least 1"),
        ("data type = 12", "data type = 6", "line 11: data type = 6: known are 1 uint8, 2 int16"),
        ("interleave = bsq", "interleave = tiles", "line 12: interleave = tiles: one of bil, bip, bsq"),
        ("byte order = 1\n", "", "no key 'byte order': one of 0, 1"),
        ("Header Offset = 3", "Header Offset = -1", "line 9: header offset = -1: at least 0"),
        ("0.6, 0.7 }", "0.6 }", "wavelength = .*: 4 are needed, one for each band; these are 3"),
        ("0.6, 0.7 }", "0.6, red }", "wavelength = .*: numbers are needed"),
        ("0.01, 0.02}", "0.01, 0.02", "line 17: the brace after 'fwhm' is never closed"),
        ("file type = ENVI Standard", "file type ENVI", "line 10: 'file type ENVI' is no 'key = value'"),
        ("file type = ENVI Standard", "file compression = 1", "line 10: file compression = 1: compressed"),
        ("lines   = 6", "lines   = 7", "has 243 bytes; its header .* wants 283"),
    ],
)
def test_headers_that_cannot_be_read(tmp_path: Path, old: str, new: str, fragment: str) -> None:
    assert old in HEADER
    with pytest.raises(CubeError, match=fragment):
        import_cube(by_hand(tmp_path, HEADER.replace(old, new)), tmp_path / "c.zarr")
    assert {path.name for path in tmp_path.iterdir()} == {"f.hdr", "f.img"}


@pytest.mark.parametrize(
    ("units", "values", "expected", "note"),
    [
        ("", "400, 500, 600, 700", [400, 500, 600, 700], "taken for nm"),
        ("Unknown", "0.4, 0.5, 0.6, 0.7", [400, 500, 600, 700], "taken for micrometres"),
        ("Wavenumber", "4, 3, 2, 1", None, "no wavelength"),
    ],
)
def test_wavelengths_without_a_length(
    tmp_path: Path, units: str, values: str, expected: list[float] | None, note: str
) -> None:
    header = HEADER.replace("0.4, 0.5,\n  0.6, 0.7", values)
    header = header.replace("wavelength units = Micrometers", f"wavelength units = {units}" if units else "")
    done = import_cube(by_hand(tmp_path, header), tmp_path / "c.zarr")
    assert note in done.notes[0]
    cube = open_cube(tmp_path / "c.zarr")
    assert (expected is None) == ("wavelength" not in cube.coords)
    if expected is not None:
        np.testing.assert_allclose(cube["wavelength"], expected)


def test_files_that_are_not_there(tmp_path: Path) -> None:
    header = by_hand(tmp_path)
    for missing, fragment in [("f.img", "no file with the pixels"), ("f.hdr", "there is no")]:
        (tmp_path / missing).rename(tmp_path / "away")
        with pytest.raises(CubeError, match=fragment):
            import_cube(tmp_path / ("f.hdr" if missing == "f.img" else "f.img"), tmp_path / "c.zarr")
        (tmp_path / "away").rename(tmp_path / missing)
    with pytest.raises(CubeError, match="there is no file"):
        import_cube(tmp_path / "g.hdr", tmp_path / "c.zarr")
    make_cube(tmp_path / "c.zarr", pixels_of((1, 1, 1), "uint8", 8), bits=8)
    with pytest.raises(CubeExists, match="exists already"):
        import_cube(header, tmp_path / "c.zarr")


def test_options_that_do_not_fit(tmp_path: Path) -> None:
    header = by_hand(tmp_path)
    wrong: list[tuple[dict[str, Any], str]] = [
        ({"calibration": "cal.nc"}, "belongs to OpenHSI"),
        ({"dtype": "float32", "significant_bits": 12}, "belong to counts"),
        ({"significant_bits": 20}, "cannot have 20 significant bits"),
    ]
    for options, fragment in wrong:
        with pytest.raises(ConfigError, match=fragment):
            import_cube(header, tmp_path / "c.zarr", **options)


def test_the_width_of_the_bands_goes_there_and_back(tmp_path: Path) -> None:
    import_cube(by_hand(tmp_path), tmp_path / "c.zarr")
    export_cube(tmp_path / "c.zarr", tmp_path / "out.bil", bands="1,3")
    assert spectral.io.envi.read_envi_header(str(tmp_path / "out.hdr"))["fwhm"] == ["10.0", "20.0"]


def test_where_an_event_loop_runs(tmp_path: Path) -> None:
    by_hand(tmp_path)

    async def main() -> None:
        with pytest.raises(RuntimeError, match="await asyncio.to_thread"):
            import_cube(tmp_path / "f.hdr", tmp_path / "c.zarr")
        await asyncio.to_thread(import_cube, tmp_path / "f.hdr", tmp_path / "c.zarr")

    asyncio.run(main())
    assert verify_cube(tmp_path / "c.zarr").intact
