"""Import the cube of another program: one function, the format by the file."""

from __future__ import annotations

import asyncio
import shutil
import time
import uuid
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from scanhsi import clock
from scanhsi.cube.durable import sync_directory
from scanhsi.cube.exchange.incoming import Incoming
from scanhsi.cube.exchange.output import output_error, refuse_existing
from scanhsi.cube.exchange.read_envi import open_envi
from scanhsi.cube.exchange.read_netcdf import is_netcdf, open_netcdf, refuse_pickle
from scanhsi.cube.exchange.source import Told
from scanhsi.cube.layout import CubeSpec
from scanhsi.cube.records import NOT_STAMPED, STAGES, LineRecords
from scanhsi.cube.writer import CubeWriter
from scanhsi.devices.errors import ConfigError, CubeError, CubeExists

PixelType = Literal["uint8", "uint16", "uint32", "float32"]

_BLOCK_BYTES: Final = 32_000_000
_EXACT: Final = {"uint8": "uint8", "uint16": "uint16", "uint32": "uint32", "int16": "float32", "float32": "float32"}
"""Type in the file -> type in the cube, where every value is kept."""

_COLUMNS: Final = ("mirror_step", "mirror_angle_rad", "frame_id", "device_ns")


@dataclass(frozen=True, slots=True)
class Imported:
    """What was imported.

    Attributes:
        path: The cube.
        format: Of the file it came from.
        shape: (bands, lines, samples).
        dtype: Of a pixel.
        missing: Number of lines without pixels.
        notes: What was decided, what was not carried over.
    """

    path: Path
    format: str
    shape: tuple[int, int, int]
    dtype: str
    missing: int
    notes: tuple[str, ...]


def import_cube(
    file: str | Path,
    output: str | Path,
    *,
    calibration: str | Path | None = None,
    dtype: PixelType | None = None,
    significant_bits: int | None = None,
    progress: Told | None = None,
) -> Imported:
    """Make a cube from an ENVI file, or a NetCDF file of OpenHSI or of `export_cube`, in bounded memory.

    The cube says where it came from (attribute ``imported_from``: file, format, header). Nothing is overwritten, and nothing stands
    under the name of the cube before it is whole. Not to be called where an event loop runs (Jupyter): there, ``await
    asyncio.to_thread(scanhsi.import_cube, ...)``.

    Args:
        file: ``.hdr`` or the file with the pixels beside it; or ``.nc``.
        output: The cube, conventionally ``*.zarr``.
        calibration: OpenHSI's calibration file (``.nc``), for wavelengths.
        dtype: Of a pixel in the cube. By default the file's own, and float32 for int16, which is exact. Others must be
            chosen: float32 rounds to 24 bits; an integer type is refused at the first value that it cannot hold exactly.
        significant_bits: Of a pixel, 12 for 12-bit cameras: then the largest such value counts as saturated.
        progress: Called with the bytes of pixels done and to do.

    Raises:
        ConfigError: An option that does not fit the file.
        CubeExists: The cube exists; it was not touched.
        CubeError: The file cannot be read, or the cube cannot be written.
    """
    _refuse_running_loop()
    file, output = Path(file), Path(output)
    refuse_existing(output)
    incoming = _open(file, None if calibration is None else Path(calibration))
    try:
        spec = _spec(incoming, dtype, significant_bits)
        _build(incoming, spec, output, progress)
    finally:
        incoming.close()
    return Imported(
        output,
        incoming.format,
        incoming.shape,
        np.dtype(spec.dtype).name,
        len(incoming.missing),
        tuple(incoming.notes),
    )


def _refuse_running_loop() -> None:
    try:
        asyncio.get_running_loop()
    except RuntimeError:
        return
    raise RuntimeError("an event loop runs here: await asyncio.to_thread(scanhsi.import_cube, ...) instead")


def _build(incoming: Incoming, spec: CubeSpec, output: Path, progress: Told | None) -> None:
    """Write the cube under another name, then give it its own."""
    building = output.with_name(f".{output.name}.{uuid.uuid4().hex}.partial")
    try:
        clock.run(_write(incoming, spec, building, progress))
        _publish(building, output)
    except OSError as error:
        raise output_error(output, error) from error
    finally:
        shutil.rmtree(building, ignore_errors=True)


def _open(file: Path, calibration: Path | None) -> Incoming:
    if not file.is_file():
        raise CubeError(f"there is no file {file}.")
    refuse_pickle(file)
    if is_netcdf(file):
        return open_netcdf(file, calibration)
    if calibration is not None:
        raise ConfigError(f"a calibration belongs to OpenHSI's NetCDF files, and {file} is none.")
    return open_envi(file)


def _spec(incoming: Incoming, dtype: PixelType | None, significant_bits: int | None) -> CubeSpec:
    chosen = dtype or _EXACT.get(incoming.dtype.name)
    if chosen is None:
        raise ConfigError(
            f"{incoming.path} holds {incoming.dtype}, which no cube does.",
            hint="--dtype float32 (rounds to 24 bits) or --dtype uint32 (refused where a value does not fit)",
        )
    if chosen != incoming.dtype.name:
        incoming.notes.append(f"{incoming.dtype} became {chosen}" + _loss(incoming.dtype.name, chosen))
    bits = None
    if chosen != "float32":
        bits = significant_bits or incoming.significant_bits or 8 * np.dtype(chosen).itemsize
    elif significant_bits is not None:
        raise ConfigError(f"significant bits belong to counts, and {incoming.path} becomes float32.")
    bands, lines, samples = incoming.shape
    pixels = {"long_name": incoming.quantity, "units": incoming.units}
    try:
        return CubeSpec(
            lines,
            bands,
            samples,
            chosen,
            bits,
            _attributes(incoming),
            incoming.wavelength_nm,
            {name: text for name, text in pixels.items() if text is not None},
        )
    except ValueError as error:
        raise ConfigError(f"{incoming.path}: {error}.") from error


def _loss(before: str, after: str) -> str:
    if _EXACT.get(before) == after:
        return ", exactly"
    return ", rounded to 24 bits" if after == "float32" else ", every value checked"


def _attributes(incoming: Incoming) -> dict[str, Any]:
    attributes: dict[str, Any] = {
        "imported_from": {
            "file": incoming.path.name,
            "format": incoming.format,
            "dtype": incoming.dtype.name,
            "imported": datetime.now(UTC).isoformat(timespec="seconds"),
            "header": incoming.header,
        },
        "versions": {"scanhsi": version("scanhsi")},
    }
    if incoming.simulated is not None:
        attributes["simulated"] = incoming.simulated
    if incoming.fwhm_nm is not None:
        attributes["fwhm_nm"] = incoming.fwhm_nm.tolist()
    return attributes


async def _write(incoming: Incoming, spec: CubeSpec, path: Path, told: Told | None) -> None:
    offset_ns = time.time_ns() - clock.now_ns()
    records = _records(incoming, offset_ns)
    writer = CubeWriter(path, spec, durability="at close", clock_offset_ns=offset_ns)  # it has no name before
    await writer.open(records)
    try:
        step = max(1, _BLOCK_BYTES // (spec.bands * spec.samples * incoming.dtype.itemsize))
        for first in range(0, spec.lines, step):
            stop = min(first + step, spec.lines)
            pixels = await asyncio.to_thread(_converted, incoming, spec, first, stop)
            for line in range(first, stop):
                await _append(writer, records, line, pixels[line - first])
            if told is not None:
                told(stop * spec.line_bytes, spec.lines * spec.line_bytes)
        await writer.flush()
    finally:
        await writer.close()


async def _append(writer: CubeWriter, records: LineRecords, line: int, frame: NDArray[Any]) -> None:
    if line not in records.missing:
        buffer = writer.buffer(line)
        if buffer is not None:
            buffer[:] = frame
    await writer.append(line)


def _converted(incoming: Incoming, spec: CubeSpec, first: int, stop: int) -> NDArray[Any]:
    """Lines in the type of the cube; lines that are nothing but "no data" are noted as missing."""
    values = incoming.read(first, stop)
    if incoming.ignore is not None:
        empty = np.isnan(values) if np.isnan(incoming.ignore) else values == incoming.ignore
        for line in np.flatnonzero(empty.all(axis=(1, 2))) + first:
            incoming.missing.setdefault(int(line), "every pixel has the data ignore value")
    dtype = np.dtype(spec.dtype)
    if values.dtype == dtype:
        return values
    if dtype.kind == "u":
        _check_fits(incoming, values, dtype, first)
    return values.astype(dtype)


def _check_fits(incoming: Incoming, values: NDArray[Any], dtype: np.dtype[Any], first: int) -> None:
    most = np.iinfo(dtype).max
    wrong = ~((values >= 0) & (values <= most) & (values == np.floor(values)))
    wrong[[line - first for line in incoming.missing if first <= line < first + len(values)]] = False
    if wrong.any():
        line, band, sample = (int(place) for place in np.argwhere(wrong)[0])
        raise CubeError(
            f"{incoming.path}: line {line + first}, band {band}, sample {sample} is {values[line, band, sample]}, "
            f"which {dtype} cannot hold.",
            hint="--dtype float32",
        )


def _records(incoming: Incoming, offset_ns: int) -> LineRecords:
    """Records of the lines, as far as the file has them. Stage stamps get the clock of now, so that ``time`` comes out right."""
    records = LineRecords(incoming.shape[1])
    for name in _COLUMNS:
        if name in incoming.columns:
            getattr(records, name)[:] = incoming.columns[name]
    start = incoming.columns.get("exposure_start_ns")
    wall = incoming.columns.get("time")
    if wall is not None:
        known = wall != NOT_STAMPED
        records.stamps["exposure_start"][known] = wall[known] - offset_ns
    if wall is not None and start is not None:  # the same shift for the other stages
        for stage in STAGES:
            column = incoming.columns.get(f"{stage}_ns")
            if column is not None and stage not in ("exposure_start", "stored"):
                known = (column != NOT_STAMPED) & (start != NOT_STAMPED) & (wall != NOT_STAMPED)
                records.stamps[stage][known] = column[known] - start[known] + wall[known] - offset_ns
    return _with_missing(records, incoming)


def _with_missing(records: LineRecords, incoming: Incoming) -> LineRecords:
    for line, reason in incoming.missing.items():
        if not 0 <= line < records.lines:
            raise CubeError(f"{incoming.path} names line {line} as missing, and has {records.lines} lines.")
        records.mark_missing(line, reason)
    incoming.missing = records.missing  # what is found on the way is missing, too
    return records


def _publish(building: Path, output: Path) -> None:
    refuse_existing(output)
    try:
        building.rename(output)
    except (FileExistsError, NotADirectoryError) as error:
        raise CubeExists(f"{output} exists by now; it was not touched.", hint="another name") from error
    sync_directory(output.parent)
