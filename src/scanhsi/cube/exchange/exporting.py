"""Export a cube: one function, a format by the name of the output."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

from scanhsi.cube.exchange.choose import choose_bands, parse_lines
from scanhsi.cube.exchange.envi import Interleave, envi_files
from scanhsi.cube.exchange.output import refuse_existing
from scanhsi.cube.exchange.source import Source, Told, open_source
from scanhsi.devices.errors import ConfigError

Format = Literal["envi", "netcdf", "matlab", "ome-tiff", "png", "geotiff"]

_ENDINGS: Final[dict[str, Format]] = {
    ".hdr": "envi",
    ".bil": "envi",
    ".bsq": "envi",
    ".bip": "envi",
    ".img": "envi",
    ".raw": "envi",
    ".dat": "envi",
    ".nc": "netcdf",
    ".mat": "matlab",
    ".ome.tif": "ome-tiff",
    ".ome.tiff": "ome-tiff",
    ".png": "png",
    ".tif": "geotiff",
    ".tiff": "geotiff",
}


@dataclass(frozen=True, slots=True)
class Exported:
    """What was written.

    Attributes:
        paths: The files.
        format: Their format.
        shape: (bands, lines, samples).
        dtype: Of a pixel.
        missing: Number of lines without pixels.
        notes: What was not carried, what is missing.
    """

    paths: tuple[Path, ...]
    format: Format
    shape: tuple[int, int, int]
    dtype: str
    missing: int
    notes: tuple[str, ...]


def export_cube(
    cube: str | Path,
    output: str | Path,
    *,
    format: Format | None = None,
    lines: slice | str | None = None,
    bands: Sequence[int] | str | None = None,
    interleave: Interleave | None = None,
    matlab: Literal["5", "7.3"] | None = None,
    progress: Told | None = None,
) -> Exported:
    """Write a cube as a file of another program, shard by shard, in bounded memory.

    Nothing is overwritten, and nothing stands under the final name before it is whole. Missing lines and saturated pixels are
    marked as the format has it; a cube that is partial, or still being written, is exported as far as it goes.

    Args:
        cube: Path of the cube.
        output: The file. Its ending tells the format: ``.hdr .bil .bsq .bip .img .raw .dat`` ENVI, ``.nc`` NetCDF-4, ``.mat``
            MATLAB, ``.ome.tif`` OME-TIFF, ``.png``, ``.tif`` GeoTIFF.
        format: Instead of the ending's.
        lines: Some lines: a slice, or text (``"10:200"``).
        bands: Some bands: indices, or text (``"803nm"``, ``"450nm:700nm"``, ``"12,40:50"``), in the order given.
        interleave: Of ENVI: ``bil`` (default), ``bsq`` or ``bip``; else from the ending.
        matlab: Version of the MAT-file; by default 5 up to 2 GB and 7.3 beyond.
        progress: Called with the bytes of pixels done and to do.

    Raises:
        ConfigError: An option, or something that the format cannot hold.
        NotACube, CubeError: The cube cannot be read, or the output cannot be written.
        CubeExists: The output exists; it was not touched.
    """
    output = Path(output)
    format = format or _format_of(output)
    interleave = interleave or _interleave_of(output)
    for path in envi_files(output, interleave) if format == "envi" else (output,):
        refuse_existing(path)
    chosen = lines if isinstance(lines, slice) else parse_lines(lines)
    if chosen.step not in (None, 1):
        raise ConfigError(f"lines {chosen}: every line of a range is exported, steps are not.")
    source = open_source(cube, chosen, lambda dataset: choose_bands(dataset, bands), progress)
    paths = _writer(format, interleave, matlab)(source, output)
    return Exported(
        tuple(paths), format, source.shape, source.dtype.name, int(source.missing.sum()), tuple(source.notes)
    )


def _writer(
    format: Format, interleave: Interleave, matlab: Literal["5", "7.3"] | None
) -> Callable[[Source, Path], list[Path]]:
    """The function that writes a format; imported here, so that one format's library is no other's cost."""
    if format == "envi":
        from scanhsi.cube.exchange.envi import write_envi

        return lambda source, output: write_envi(source, output, interleave=interleave)
    if format == "netcdf":
        from scanhsi.cube.exchange.netcdf import write_netcdf

        return write_netcdf
    if format == "matlab":
        from scanhsi.cube.exchange.matlab import write_matlab

        return lambda source, output: write_matlab(source, output, version=matlab)
    if format == "ome-tiff":
        from scanhsi.cube.exchange.ome_tiff import write_ome_tiff

        return write_ome_tiff
    if format == "png":
        from scanhsi.cube.exchange.png import write_png

        return write_png
    if format == "geotiff":
        from scanhsi.cube.exchange.raster import write_geotiff

        return write_geotiff
    raise ConfigError(f"format {format!r} is none of {', '.join(dict.fromkeys(_ENDINGS.values()))}.")


def _format_of(output: Path) -> Format:
    name = output.name.lower()
    for ending in sorted(_ENDINGS, key=len, reverse=True):
        if name.endswith(ending):
            return _ENDINGS[ending]
    if name.endswith((".pkl", ".pickle", ".npz")):
        raise ConfigError(f"{output}: no pickle, ever: loading one runs whatever code is in it.", hint="out.nc")
    raise ConfigError(f"{output} has no ending that tells a format; known are {' '.join(_ENDINGS)}.", hint="--format")


def _interleave_of(output: Path) -> Interleave:
    ending = output.suffix.lower()
    return "bsq" if ending == ".bsq" else "bip" if ending == ".bip" else "bil"
