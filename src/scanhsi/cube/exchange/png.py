"""PNG: one band in grey, or three bands as red, green and blue, for looking at. Written row by row, at any size."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from scanhsi.cube.exchange.output import new_files
from scanhsi.cube.exchange.source import Source
from scanhsi.devices.errors import ConfigError


def write_png(source: Source, output: Path) -> list[Path]:
    """Write a picture of one or three bands, 8 or 16 bits a pixel with alpha; returns the path.

    Counts are stretched over the whole range, so that saturated pixels are the brightest there can be; shifted right by the bits
    that were added (the sBIT chunk tells) they are the counts again. Missing lines are transparent.

    Raises:
        ConfigError: Another number of bands, or pixels that a PNG cannot hold.
        CubeExists, CubeError: As `new_files`.
    """
    bands, lines, samples = source.shape
    if bands not in (1, 3):
        raise ConfigError(f"a PNG shows 1 or 3 bands, not {bands}.", hint="--bands 803nm, or an OME-TIFF")
    bits = source.significant_bits
    if bits is None or source.dtype.itemsize > 2:
        raise ConfigError(f"a PNG holds 8 or 16 bits a pixel, not {source.dtype}.", hint="an OME-TIFF")
    depth = 8 * source.dtype.itemsize
    with new_files(output) as (new,), new.open("wb") as file:
        file.write(b"\x89PNG\r\n\x1a\n")
        colour_type = 4 if bands == 1 else 6
        _chunk(file, b"IHDR", struct.pack(">IIBBBBB", samples, lines, depth, colour_type, 0, 0, 0))
        _chunk(file, b"sBIT", bytes([bits] * bands + [depth]))
        _chunk(file, b"tEXt", b"Title\0" + source.summary.encode("latin-1", "replace"))
        packer = zlib.compressobj(6)
        for first, pixels in source.blocks():
            shown = ~source.missing[first : first + pixels.shape[1]]
            _chunk(file, b"IDAT", packer.compress(_rows(pixels, shown, bits, depth)))
        _chunk(file, b"IDAT", packer.flush())
        _chunk(file, b"IEND", b"")
    source.notes.append("a PNG is a picture: no wavelengths, no records of the lines")
    return [output]


def _rows(pixels: NDArray[Any], shown: NDArray[np.bool_], bits: int, depth: int) -> bytes:
    """Rows of samples, channels beside each other and alpha behind them, big-endian, a filter byte 0 before each row."""
    bands, lines, samples = pixels.shape
    most = 2**depth - 1
    stretched = (pixels.astype(np.uint32) * np.uint32(most) + (2**bits - 1) // 2) // np.uint32(2**bits - 1)
    whole = np.empty((lines, samples, bands + 1), f">u{depth // 8}")
    whole[..., :bands] = np.minimum(stretched, most).transpose(1, 2, 0)
    whole[..., bands] = np.where(shown, most, 0)[:, None]
    rows = np.zeros((lines, 1 + samples * (bands + 1) * depth // 8), np.uint8)
    rows[:, 1:] = whole.view(np.uint8).reshape(lines, -1)
    return rows.tobytes()


def _chunk(file: BinaryIO, kind: bytes, data: bytes) -> None:
    file.write(struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(data, zlib.crc32(kind))))
