"""The twin packs pixels as a GigE Vision camera does; our own unpacker and the words of the standard check it."""

import numpy as np
import pytest

from scanhsi.devices.pixels import PixelFormat, unpack
from scanhsi_sim.twins.payload import BITS, MONO8, MONO12, MONO12_PACKED, MONO16, pack

CODES = {"Mono8": MONO8, "Mono12": MONO12, "Mono12Packed": MONO12_PACKED, "Mono16": MONO16}


@pytest.mark.parametrize("pixel_format", PixelFormat)
def test_unpacks_to_the_same_pixels(pixel_format: PixelFormat) -> None:
    code = CODES[pixel_format.value]
    rng = np.random.default_rng(1)
    wide = rng.integers(0, 1 << BITS[code], (6, 10), np.uint16)
    pixels, out = (wide, np.empty_like(wide))
    if code == MONO8:
        pixels, out = wide.astype(np.uint8), np.empty(wide.shape, np.uint8)
    unpack(pack(pixels, code), pixel_format, out)
    np.testing.assert_array_equal(out, wide << 4 if code == MONO16 else wide)


def test_mono12packed_layout() -> None:
    pixels = np.array([[0xABC, 0x123]], np.uint16)
    assert pack(pixels, MONO12_PACKED).tolist() == [0xAB, 0x3C, 0x12]


def test_a_cropped_view_packs_like_its_copy() -> None:
    pixels = np.arange(200, dtype=np.uint16).reshape(10, 20)[2:6, 4:12]
    np.testing.assert_array_equal(pack(pixels, MONO12_PACKED), pack(pixels.copy(), MONO12_PACKED))
