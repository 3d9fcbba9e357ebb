"""GeoTIFF through GDAL: cubes that are rectified, so that a pixel has a place in millimetres."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final, cast

import numpy as np
from numpy.typing import NDArray

from scanhsi.cube.exchange.output import new_files
from scanhsi.cube.exchange.source import Source
from scanhsi.devices.errors import ConfigError, CubeError

_UNEVEN: Final = 0.01
"""How far a coordinate may be from its grid, in pixels."""

_CRS: Final = 'LOCAL_CS["object plane",UNIT["millimetre",0.001]]'


def write_geotiff(source: Source, output: Path) -> list[Path]:
    """Write a GeoTIFF with all chosen bands, compressed (deflate); returns the path.

    The transform is in millimetres of the object plane. No-data value: as `write_envi`.

    Raises:
        ConfigError: The cube is not rectified, or rasterio is not installed.
        CubeExists, CubeError: As `new_files`.
    """
    x, y = _axis(source, "x", "sample"), _axis(source, "y", "line")
    try:
        import rasterio
        from rasterio.errors import RasterioIOError
    except ImportError as error:
        raise ConfigError(
            "GeoTIFF is written by rasterio, which is missing.", hint="pip install 'scanhsi[gdal]'"
        ) from error
    bands, lines, samples = source.shape
    profile: dict[str, Any] = {
        "driver": "GTiff",
        "width": samples,
        "height": lines,
        "count": bands,
        "dtype": source.dtype.name,
        "nodata": source.filler,
        "transform": rasterio.Affine(x[1], 0.0, x[0] - x[1] / 2, 0.0, y[1], y[0] - y[1] / 2),
        "crs": _CRS,
        "compress": "deflate",
        "interleave": "band",
        "bigtiff": "if_safer",
        "blockysize": source.chunk[1],
    }
    wavelength = source.wavelength_nm
    with new_files(output) as (new,):
        try:
            with cast("Any", rasterio.open(new, "w", **profile)) as raster:
                raster.update_tags(TIFFTAG_IMAGEDESCRIPTION=source.summary)
                for number in range(1, bands + 1):
                    if wavelength is not None:
                        raster.update_tags(
                            number, wavelength=repr(float(wavelength[number - 1])), wavelength_units="nm"
                        )
                        raster.set_band_description(number, f"{wavelength[number - 1]:.2f} nm")
                for first, pixels in source.blocks(source.filler):
                    raster.write(pixels, window=((first, first + pixels.shape[1]), (0, samples)))
        except RasterioIOError as error:
            raise CubeError(f"GDAL cannot write {output}: {error}") from error
    source.notes.append("GeoTIFF carries no records of the lines: no mirror angles, no time stamps")
    return [output]


def _axis(source: Source, name: str, dimension: str) -> tuple[float, float]:
    """(centre of the first pixel, pitch) of an even axis, mm."""
    array = source.dataset.variables.get(name)
    if array is None or array.dims != (dimension,) or array.attrs.get("units") != "mm":
        raise _refusal(source, f"it has no coordinate {name} ({dimension}) in mm")
    places: NDArray[np.float64] = np.asarray(array.values, np.float64)
    if len(places) < 2 or not np.isfinite(places).all():
        raise _refusal(source, f"its coordinate {name} is too short or has gaps")
    pitch = float((places[-1] - places[0]) / (len(places) - 1))
    even = places[0] + pitch * np.arange(len(places))
    if pitch == 0 or float(np.abs(places - even).max()) > _UNEVEN * abs(pitch):
        raise _refusal(source, f"its pixels are not evenly spaced along {name}")
    return float(places[0]), pitch


def _refusal(source: Source, why: str) -> ConfigError:
    return ConfigError(
        f"{source.path} is not rectified: {why}. A GeoTIFF needs an even grid.", hint="ENVI, NetCDF or OME-TIFF"
    )
