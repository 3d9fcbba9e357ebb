"""Pixel formats unpack bit-exactly, whatever the shape and alignment."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from scanhsi.devices import PixelFormat, unpack


def pack12(pixels: NDArray[np.uint16]) -> NDArray[np.uint8]:
    """Mono12Packed, byte by byte as the GigE Vision standard draws it."""
    pairs = pixels.reshape(-1, 2)
    packed = np.empty((len(pairs), 3), np.uint8)
    packed[:, 0] = pairs[:, 0] >> 4
    packed[:, 1] = (pairs[:, 0] & 0xF) | (pairs[:, 1] & 0xF) << 4
    packed[:, 2] = pairs[:, 1] >> 4
    return packed.reshape(-1)


@given(bands=st.integers(1, 9), pairs=st.integers(1, 20), seed=st.integers(0, 99), shift=st.integers(0, 3))
def test_mono12_packed(bands: int, pairs: int, seed: int, shift: int) -> None:
    pixels = np.random.default_rng(seed).integers(0, 4096, (bands, 2 * pairs), dtype=np.uint16)
    packed = pack12(pixels)
    memory = np.zeros(packed.size + shift, np.uint8)  # the payload may begin at any address
    memory[shift:] = packed
    payload = memory[shift:]
    payload.flags.writeable = False
    out = np.full_like(pixels, 0xFFFF)
    unpack(payload, PixelFormat.MONO12_PACKED, out)
    assert np.array_equal(out, pixels)


@pytest.mark.parametrize("pixel_format", [PixelFormat.MONO8, PixelFormat.MONO12, PixelFormat.MONO16])
def test_unpacked_formats_are_copied(pixel_format: PixelFormat) -> None:
    pixels = np.random.default_rng(1).integers(0, 2**pixel_format.bits, (7, 5)).astype(pixel_format.dtype)
    out = np.zeros_like(pixels)
    unpack(pixels.reshape(-1).view(np.uint8), pixel_format, out)
    assert np.array_equal(out, pixels)


def test_what_does_not_fit_is_refused() -> None:
    with pytest.raises(ValueError, match=r"Mono12Packed of \(2, 4\) is 12 bytes, not 11"):
        unpack(np.zeros(11, np.uint8), PixelFormat.MONO12_PACKED, np.zeros((2, 4), np.uint16))
    with pytest.raises(ValueError, match="C-contiguous 2-D uint16"):
        unpack(np.zeros(12, np.uint8), PixelFormat.MONO12_PACKED, np.zeros((2, 4), np.uint8))
    with pytest.raises(ValueError, match="C-contiguous"):
        unpack(np.zeros(12, np.uint8), PixelFormat.MONO12_PACKED, np.zeros((4, 2), np.uint16).T)


def test_bytes_on_the_wire() -> None:
    sizes = {name: PixelFormat(name).payload_bytes((1088, 2048)) for name in ("Mono8", "Mono12Packed", "Mono12")}
    assert sizes == {"Mono8": 2_228_224, "Mono12Packed": 3_342_336, "Mono12": 4_456_448}
