"""Pixel formats of GigE Vision monochrome cameras, and unpacking them.

`PixelFormat` names are those of the GenICam standard features naming convention. 12-bit formats unpack to uint16 with 12
significant bits; nothing is ever scaled.
"""

from __future__ import annotations

from enum import StrEnum, unique

import numpy as np
from numpy.typing import DTypeLike, NDArray


@unique
class PixelFormat(StrEnum):
    """A pixel format by its GenICam name."""

    MONO8 = "Mono8"
    MONO12 = "Mono12"
    MONO12_PACKED = "Mono12Packed"
    MONO16 = "Mono16"

    @property
    def bits(self) -> int:
        """Significant bits of a pixel."""
        return {"Mono8": 8, "Mono16": 16}.get(self.value, 12)

    @property
    def bits_on_wire(self) -> int:
        """Bits that a pixel occupies on the link."""
        return {"Mono8": 8, "Mono12Packed": 12}.get(self.value, 16)

    @property
    def dtype(self) -> DTypeLike:
        """numpy type of unpacked pixels."""
        return np.uint8 if self is PixelFormat.MONO8 else np.uint16

    def payload_bytes(self, shape: tuple[int, int]) -> int:
        """Bytes of one frame of ``shape`` (bands, samples) on the link."""
        return -(-shape[0] * shape[1] * self.bits_on_wire // 8)


def unpack(payload: NDArray[np.uint8], pixel_format: PixelFormat, out: NDArray[np.uint8] | NDArray[np.uint16]) -> None:
    """Unpack the payload of one frame into ``out``.

    Args:
        payload: 1-D uint8, as it came over the wire.
        pixel_format: How the pixels lie in it.
        out: (bands, samples), C-contiguous, of ``pixel_format.dtype``. For Mono12Packed the number of pixels must be even.

    Raises:
        ValueError: Payload size, pixel format and ``out`` do not fit together.
    """
    if out.dtype != np.dtype(pixel_format.dtype) or not out.flags.c_contiguous or out.ndim != 2:
        raise ValueError(f"{pixel_format} unpacks into a C-contiguous 2-D {np.dtype(pixel_format.dtype)} array")
    expected = pixel_format.payload_bytes((out.shape[0], out.shape[1]))
    if payload.size != expected:
        raise ValueError(f"{pixel_format} of {out.shape} is {expected} bytes, not {payload.size}")
    if pixel_format is PixelFormat.MONO12_PACKED:
        _unpack_mono12_packed(payload, out.reshape(-1))
    else:
        np.copyto(out.reshape(-1), payload.view(out.dtype))


def _unpack_mono12_packed(payload: NDArray[np.uint8], out: NDArray[np.uint16] | NDArray[np.uint8]) -> None:
    """Two pixels in three bytes (GigE Vision): p0[11:4], p1[3:0] p0[3:0], p1[11:4].

    Four bytes are read at each triplet as one little-endian word, which holds p1[11:0] p0[3:0] p0[11:4] from bit 23 down, and
    are turned into the two pixels in place: a pass over words takes a sixth of the time of passes over bytes.
    """
    count = payload.size // 3
    words = out.view("<u4")[:-1]
    words[:] = np.ndarray((count - 1,), "<u4", payload, strides=(3,))  # the last one would read past the end
    low = words >> 8
    low &= 0x0F
    words &= 0x00FFF0FF
    words <<= 4
    words |= low
    first, middle, last = payload[-3:].tolist()
    out[-2:] = first << 4 | middle & 0x0F, last << 4 | middle >> 4
