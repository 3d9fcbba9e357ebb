"""Pixels as they lie in the payload of a GigE Vision frame."""

import numpy as np
from numpy.typing import NDArray

from scanhsi_sim.scenes import Image

MONO8, MONO12, MONO12_PACKED, MONO16 = 0x01080001, 0x01100005, 0x010C0006, 0x01100007
"""PFNC codes of the pixel formats."""

BITS = {MONO8: 8, MONO12: 12, MONO12_PACKED: 12, MONO16: 12}
"""What the sensor is asked for. The sensor has 12 bits: they are the upper ones of Mono16."""


def pack(pixels: Image, pixel_format: int) -> NDArray[np.uint8]:
    """The payload of one frame.

    Args:
        pixels: (bands, samples), uint8 for Mono8, else uint16 with 12 significant bits; an even number of them.
        pixel_format: PFNC code.

    Returns:
        1-D uint8, contiguous.
    """
    flat = np.ascontiguousarray(pixels).reshape(-1)
    if pixel_format == MONO12_PACKED:
        return _pack_mono12(flat.astype(np.uint16, copy=False))
    if pixel_format == MONO16:
        flat = flat << 4
    return flat.view(np.uint8)


def _pack_mono12(flat: NDArray[np.uint16]) -> NDArray[np.uint8]:
    """GigE Vision Mono12Packed: two pixels in three bytes, p0[11:4], p1[3:0] p0[3:0], p1[11:4]."""
    octets = flat.view(np.uint8).reshape(-1, 4)  # of two little-endian pixels
    upper = (flat >> 4).astype(np.uint8).reshape(-1, 2)
    packed = np.empty((flat.size // 2, 3), np.uint8)
    packed[:, 0] = upper[:, 0]
    packed[:, 1] = (octets[:, 0] & 0x0F) | (octets[:, 2] << 4)
    packed[:, 2] = upper[:, 1]
    return packed.reshape(-1)
