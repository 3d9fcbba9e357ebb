"""Opens ENVI files for import: any interleave, byte order, header offset, and every type but complex."""

from __future__ import annotations

from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np
from numpy.typing import NDArray

from scanhsi.cube.exchange.envi import DATA_TYPES
from scanhsi.cube.exchange.envi_header import EnviHeader, read_header, wavelengths
from scanhsi.cube.exchange.incoming import Incoming
from scanhsi.devices.errors import CubeError

_ENDINGS: Final = ("", ".img", ".dat", ".raw", ".bil", ".bsq", ".bip", ".hyspex", ".bin")


def envi_pair(path: Path) -> tuple[Path, Path]:
    """(header, body) of an ENVI file, whichever of them was named.

    Raises:
        CubeError: One of them is not there.
    """
    if path.suffix.lower() == ".hdr":
        stem = path.with_suffix("")
        found = [stem.with_name(stem.name + ending) for ending in _ENDINGS]
        bodies = [body for body in (*found, *(Path(f"{body}".upper()) for body in found[1:])) if body.is_file()]
        if not bodies:
            raise CubeError(f"beside {path} there is no file with the pixels.", hint=f"a file named {stem.name}.img")
        return path, bodies[0]
    headers = [path.with_suffix(".hdr"), path.with_name(path.name + ".hdr"), path.with_suffix(".HDR")]
    header = next((header for header in headers if header.is_file()), None)
    if header is None or not path.is_file():
        missing = path if header else headers[0]
        raise CubeError(f"there is no {missing}: ENVI is a header (.hdr) and a file with the pixels.")
    return header, path


def open_envi(path: Path) -> Incoming:
    """Open an ENVI file.

    Raises:
        CubeError: A file is missing or too short, or the header has something that cannot be read.
    """
    header_path, body = envi_pair(path)
    header = read_header(header_path)
    shape = tuple(header.integer(key, least=1) for key in ("bands", "lines", "samples"))
    bands, lines, samples = shape
    dtype = _dtype(header)
    if header.integer("file compression", least=0, default=0):
        raise header.problem("file compression", "compressed files are not read.", hint="decompress it first")
    reader = _Reader(header, body, (bands, lines, samples), dtype)
    notes: list[str] = []
    incoming = Incoming(
        path=path,
        format="ENVI",
        shape=(bands, lines, samples),
        dtype=dtype.newbyteorder("="),
        read=reader.read,
        close=lambda: None,  # it is opened for each read
        header=dict(header.values),
        wavelength_nm=wavelengths(header, "wavelength", bands, notes),
        fwhm_nm=wavelengths(header, "fwhm", bands, notes),
        ignore=header.number("data ignore value"),
        quantity=header.values.get("scanhsi quantity"),
        units=header.values.get("data units"),
        notes=notes,
    )
    _read_own_keys(header, incoming)
    return incoming


def _dtype(header: EnviHeader) -> np.dtype[Any]:
    number = header.integer("data type", least=1)
    if number not in DATA_TYPES:
        known = ", ".join(f"{number} {dtype}" for number, dtype in DATA_TYPES.items())
        raise header.problem("data type", f"known are {known}.")
    big = header.choice("byte order", {"0": False, "1": True}, "0" if DATA_TYPES[number].itemsize == 1 else None)
    return DATA_TYPES[number].newbyteorder(">" if big else "<")


def _read_own_keys(header: EnviHeader, incoming: Incoming) -> None:
    """What an export of ours says beyond ENVI."""
    if "scanhsi significant bits" in header.values:
        incoming.significant_bits = header.integer("scanhsi significant bits", least=1)
    if "scanhsi simulated" in header.values:
        incoming.simulated = header.choice("scanhsi simulated", {"true": True, "false": False})
    missing = header.numbers("scanhsi missing lines")
    if missing is not None:
        incoming.missing = dict.fromkeys((int(line) for line in missing), f"missing in {incoming.path.name}")
    if "scanhsi quantity" in header.values:
        incoming.ignore = None  # it is the value of saturated pixels, too, and missing lines are listed


class _Reader:
    """Reads lines from the body: with plain reads, for a file that shrinks under a memory map kills the process."""

    def __init__(self, header: EnviHeader, body: Path, shape: tuple[int, int, int], dtype: np.dtype[Any]) -> None:
        self._body = body
        self._shape = shape
        self._dtype = dtype
        self._offset = header.integer("header offset", least=0, default=0)
        interleaves = {"bil": (1, 0, 2), "bip": (1, 2, 0), "bsq": (0, 1, 2)}
        self._order = header.choice("interleave", interleaves)
        needed = self._offset + int(np.prod(shape)) * dtype.itemsize
        size = body.stat().st_size
        if size < needed:
            raise CubeError(
                f"{body} has {size} bytes; its header {header.path} wants {needed}: "
                f"{' x '.join(str(n) for n in shape)} of {dtype.itemsize} bytes after {self._offset}.",
                hint="copy it again, or correct samples, lines, bands, data type or header offset",
            )

    def read(self, first: int, stop: int) -> NDArray[Any]:
        """Pixels (line, band, sample) of some lines."""
        bands, lines, samples = self._shape
        try:
            with self._body.open("rb") as file:
                if self._order == (0, 1, 2):
                    pixels = np.empty((stop - first, bands, samples), self._dtype)
                    for band in range(bands):
                        pixels[:, band] = self._values(file, (band * lines + first) * samples, (stop - first, samples))
                elif self._order == (1, 0, 2):
                    pixels = self._values(file, first * bands * samples, (stop - first, bands, samples))
                else:
                    values = self._values(file, first * bands * samples, (stop - first, samples, bands))
                    pixels = values.transpose(0, 2, 1)
        except OSError as error:
            raise CubeError(f"cannot read {self._body}: {error.strerror or error}.") from error
        return pixels

    def _values(self, file: BinaryIO, start: int, shape: tuple[int, ...]) -> NDArray[Any]:
        file.seek(self._offset + start * self._dtype.itemsize)
        values = np.fromfile(file, self._dtype, int(np.prod(shape)))
        if values.size < np.prod(shape):
            raise CubeError(f"{self._body} became shorter while it was read.")
        return values.reshape(shape)
