"""ENVI: a text header beside a file of plain numbers. With BIL interleave the numbers are the frames, one after the other."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, BinaryIO, Final, Literal

import numpy as np
from numpy.typing import NDArray

from scanhsi.cube.exchange.output import new_files
from scanhsi.cube.exchange.source import Source

Interleave = Literal["bil", "bsq", "bip"]
"""Order on disk: (line, band, sample) as frames come, (band, line, sample), (line, sample, band)."""

DATA_TYPES: Final = {
    1: np.dtype(np.uint8),
    2: np.dtype(np.int16),
    3: np.dtype(np.int32),
    4: np.dtype(np.float32),
    5: np.dtype(np.float64),
    12: np.dtype(np.uint16),
    13: np.dtype(np.uint32),
    14: np.dtype(np.int64),
    15: np.dtype(np.uint64),
}
"""ENVI's numbers of the types that a pixel may have."""

_IN_A_ROW: Final = 8
_COLOURS_NM: Final = (640.0, 550.0, 460.0)


def envi_files(output: Path, interleave: Interleave) -> tuple[Path, Path]:
    """(header, body) of an output: named after the one or the other."""
    if output.suffix.lower() == ".hdr":
        return output, output.with_suffix(f".{interleave}")
    return output.with_suffix(".hdr"), output


def write_envi(source: Source, output: Path, *, interleave: Interleave = "bil") -> list[Path]:
    """Write header and body; returns their paths.

    ``data ignore value`` is the value of saturated pixels (nan for float), and lines that are missing are filled with it.

    Raises:
        CubeExists, CubeError: As `new_files`.
    """
    header, body = envi_files(output, interleave)
    with new_files(header, body) as (new_header, new_body):
        with new_body.open("wb") as file:
            _WRITERS[interleave](source, file)
        new_header.write_text("\n".join(_header(source, interleave)) + "\n", encoding="utf-8")
    source.notes.append("per line, ENVI carries only which lines are missing: no mirror angles, no time stamps")
    if source.saturation is not None and source.missing.any():
        source.notes.append(f"missing lines hold {source.filler}, as saturated pixels do: it is the data ignore value")
    return [header, body]


def _write_bil(source: Source, file: BinaryIO) -> None:
    for _, pixels in source.blocks(source.filler):
        file.write(_little(pixels.transpose(1, 0, 2)))


def _write_bip(source: Source, file: BinaryIO) -> None:
    for _, pixels in source.blocks(source.filler):
        file.write(_little(pixels.transpose(1, 2, 0)))


def _write_bsq(source: Source, file: BinaryIO) -> None:
    write_planes(source, file, 0)


_WRITERS: Final[dict[str, Callable[[Source, BinaryIO], None]]] = {
    "bil": _write_bil,
    "bip": _write_bip,
    "bsq": _write_bsq,
}


def write_planes(source: Source, file: BinaryIO, offset: int) -> None:
    """Write bands one after the other from ``offset`` on, little-endian, missing lines filled; the file grows as it must."""
    _, lines, samples = source.shape
    row = samples * source.dtype.itemsize
    for first, pixels in source.blocks(source.filler):
        for band, plane in enumerate(pixels):
            file.seek(offset + (band * lines + first) * row)
            file.write(_little(plane))


def _little(pixels: NDArray[Any]) -> memoryview:
    return np.ascontiguousarray(pixels, pixels.dtype.newbyteorder("<")).data.cast("B")


def _header(source: Source, interleave: Interleave) -> list[str]:
    bands, lines, samples = source.shape
    numbers = {dtype: number for number, dtype in DATA_TYPES.items()}
    head = [
        "ENVI",
        f"description = {_braces([source.summary])}",
        f"samples = {samples}",
        f"lines = {lines}",
        f"bands = {bands}",
        "header offset = 0",
        "file type = ENVI Standard",
        f"data type = {numbers[source.dtype]}",
        f"interleave = {interleave}",
        "byte order = 0",
        f"data ignore value = {source.filler}",
        f"data units = {source.units}",
    ]
    wavelength = source.wavelength_nm
    if wavelength is not None:
        head += ["wavelength units = Nanometers", f"wavelength = {_braces(wavelength.tolist())}"]
        colours = [int(np.abs(wavelength - nm).argmin()) for nm in _COLOURS_NM]
        if len(set(colours)) == 3:
            head.append(f"default bands = {_braces(band + 1 for band in colours)}")
    if source.fwhm_nm is not None:
        head.append(f"fwhm = {_braces(source.fwhm_nm.tolist())}")
    return [*head, *_own_keys(source)]


def _own_keys(source: Source) -> list[str]:
    """What ENVI has no key for. Other programs skip keys that they do not know."""
    head = [f"scanhsi quantity = {source.quantity}"]
    if source.significant_bits is not None:
        head.append(f"scanhsi significant bits = {source.significant_bits}")
    if source.simulated is not None:
        head.append(f"scanhsi simulated = {str(source.simulated).lower()}")
    if source.missing.any():
        head.append(f"scanhsi missing lines = {_braces(np.flatnonzero(source.missing).tolist())}")
    return head


def _braces(values: Iterable[object]) -> str:
    """A list as ENVI has them, some values a line: GDAL reads no line of more than 10000 characters."""
    words = [str(value).translate({ord("{"): "(", ord("}"): ")", ord("\n"): " "}) for value in values]
    rows = [", ".join(words[start : start + _IN_A_ROW]) for start in range(0, len(words), _IN_A_ROW)]
    return "{" + ",\n ".join(rows) + "}"
