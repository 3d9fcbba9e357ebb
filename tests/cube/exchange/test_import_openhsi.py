"""NetCDF as OpenHSI writes it (`DataCube.save`, `CameraProperties.dump`), in both orders of its axes."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

from scanhsi import ConfigError, CubeError, import_cube, open_cube
from support.exports import pixels_of

BANDS, LINES, SAMPLES = 5, 7, 6
TIMES = np.datetime64("2024-03-01T10:00:00.000123", "ns") + np.arange(LINES) * np.timedelta64(22_000_001, "ns")
WAVELENGTH_NM = np.array([430.1, 434.1, 438.1, 442.1, 446.1])


def save(
    path: Path,
    pixels: np.ndarray,
    *,
    old_style: bool = False,
    wavelength: Any = WAVELENGTH_NM,
    engine: Any = "h5netcdf",
) -> Path:
    """Pixels (band, line, sample) as OpenHSI has them: x across the track, y along it."""
    dataset = xr.Dataset(
        {"datacube": (["wavelength", "x", "y"], pixels.transpose(0, 2, 1))},
        coords={
            "wavelength": wavelength,
            "x": np.arange(SAMPLES),
            "y": np.arange(LINES),
            "time": TIMES,
            "temperature": (["temperature"], np.linspace(30, 31, LINES)),
        },
        attrs={"site": "beach", "altitude": 0.12},
    )
    dataset["wavelength"].attrs["units"] = "nanometers"
    dataset["datacube"].attrs |= {
        "long_name": "hyperspectral datacube",
        "units": "digital number" if pixels.dtype.kind == "u" else "uW/cm^2/sr/nm",
    }
    if old_style:
        dataset = dataset.transpose("x", "y", "wavelength", ...)
    dataset.to_netcdf(path, engine=engine)
    return path


@pytest.mark.parametrize("old_style", [False, True])
@pytest.mark.parametrize(("dtype", "bits"), [("uint8", 8), ("uint16", 12), ("float32", None)])
def test_cubes(tmp_path: Path, old_style: bool, dtype: str, bits: int | None) -> None:
    pixels = pixels_of((BANDS, LINES, SAMPLES), dtype, bits)
    done = import_cube(save(tmp_path / "o.nc", pixels, old_style=old_style), tmp_path / "c.zarr")
    assert (done.format, done.shape, done.dtype) == ("OpenHSI NetCDF", (BANDS, LINES, SAMPLES), dtype)
    cube = open_cube(tmp_path / "c.zarr")
    np.testing.assert_array_equal(cube["cube"].values, pixels)
    np.testing.assert_array_equal(cube["wavelength"].values, WAVELENGTH_NM)
    np.testing.assert_array_equal(cube["time"].values, TIMES)
    assert (cube["status"].values == 1).all()
    assert cube["cube"].attrs["units"] == ("digital number" if bits else "uW/cm^2/sr/nm")
    header = cube.attrs["imported_from"]["header"]
    assert header["site"] == "beach"
    assert header["temperature_degC"][0] == 30
    assert "simulated" not in cube.attrs


def test_the_classic_format(tmp_path: Path) -> None:
    """What xarray writes where only scipy is installed. It has no unsigned types; OpenHSI's processed cubes are float32."""
    pixels = pixels_of((BANDS, LINES, SAMPLES), "float32", None)
    import_cube(save(tmp_path / "o.nc", pixels, engine="scipy"), tmp_path / "c.zarr")
    np.testing.assert_array_equal(open_cube(tmp_path / "c.zarr")["cube"].values, pixels)


def calibration(path: Path, bands: int) -> Path:
    dataset = xr.Dataset(
        {
            "flat_field_pic": (["flat_field_pic_dim_x", "flat_field_pic_dim_y"], np.ones((90, 90), np.uint16)),
            "smile_shifts": (["smile_shifts_dim"], np.arange(SAMPLES)),
            "wavelengths": (["wavelengths_dim"], np.linspace(400, 800, bands)),
        },
        attrs={"spec_rad_ref_luminance": 52020},
    )
    dataset.to_netcdf(path, engine="h5netcdf")
    return path


def test_calibration_gives_raw_cubes_their_wavelengths(tmp_path: Path) -> None:
    pixels = pixels_of((BANDS, LINES, SAMPLES), "uint16", 12)
    raw = save(tmp_path / "o.nc", pixels, wavelength=np.arange(BANDS))
    done = import_cube(raw, tmp_path / "without.zarr")
    assert "wavelength" not in open_cube(tmp_path / "without.zarr").coords
    assert any("no wavelengths" in note for note in done.notes)
    done = import_cube(raw, tmp_path / "c.zarr", calibration=calibration(tmp_path / "cal.nc", BANDS))
    cube = open_cube(tmp_path / "c.zarr")
    np.testing.assert_array_equal(cube["wavelength"].values, np.linspace(400, 800, BANDS))
    kept = cube.attrs["imported_from"]["header"]["calibration"]
    assert kept["smile_shifts"] == list(range(SAMPLES))
    assert kept["attributes"] == {"spec_rad_ref_luminance": 52020}
    assert len(kept["sha256"]) == 64
    assert any("not carried over from cal.nc: flat_field_pic (90, 90)" in note for note in done.notes)
    with pytest.raises(CubeError, match="no wavelengths for 5 bands"):
        import_cube(raw, tmp_path / "d.zarr", calibration=calibration(tmp_path / "other.nc", BANDS + 1))


class Trap:
    """Loading this writes a file."""

    def __reduce__(self) -> tuple[Any, ...]:
        return (open, ("trapped", "w"))


@pytest.mark.parametrize("name", ["cal.pkl", "innocent.nc"])
def test_pickles_are_refused_unopened(tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).write_bytes(pickle.dumps(Trap()))
    raw = save(tmp_path / "o.nc", pixels_of((BANDS, LINES, SAMPLES), "uint8", 8), wavelength=np.arange(BANDS))
    with pytest.raises(CubeError, match=r"is a pickle.*whatever code is in it.*CameraProperties"):
        import_cube(raw, tmp_path / "c.zarr", calibration=tmp_path / name)
    with pytest.raises(CubeError, match="is a pickle"):
        import_cube(tmp_path / name, tmp_path / "c.zarr")
    assert {path.name for path in tmp_path.iterdir()} == {name, "o.nc"}


def test_other_files(tmp_path: Path) -> None:
    xr.Dataset({"sst": (["lat"], np.zeros(3))}).to_netcdf(tmp_path / "sea.nc", engine="h5netcdf")
    with pytest.raises(CubeError, match=r"holds sst \('lat',\); OpenHSI has datacube"):
        import_cube(tmp_path / "sea.nc", tmp_path / "c.zarr")
    (tmp_path / "junk.nc").write_text("hello")
    with pytest.raises(CubeError, match="cannot be read as NetCDF"):
        import_cube(tmp_path / "junk.nc", tmp_path / "c.zarr")
    with pytest.raises(ConfigError, match="significant bits belong to counts"):
        import_cube(
            save(tmp_path / "o.nc", pixels_of((BANDS, LINES, SAMPLES), "float32", None)),
            tmp_path / "c.zarr",
            significant_bits=12,
        )
