"""What viewers see of a frame: small pictures and a few numbers. Pure functions, run in threads."""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from scanhsi.calibration.online import online_quicklook
from scanhsi.characterise.aids import sharpness
from scanhsi.devices.errors import CalibrationError
from scanhsi.devices.frames import Pixels

WIDTH: Final = 600
HEIGHT: Final = 200
"""Most samples and bands of a picture of a frame."""
BINS: Final = 64
_BAND_STRIDE: Final = 8
_ROWS: Final = 64
_FOCUS: Final = (256, 512)
"""Bands and samples, in the middle of the frame, that the focus score looks at."""

Bytes = NDArray[np.uint8]


def message(header: dict[str, Any], payload: bytes | memoryview) -> bytes:
    """A binary message: length of the header (uint32, little-endian), header (JSON), payload."""
    text = json.dumps(header, separators=(",", ":")).encode()
    return b"".join((struct.pack("<I", len(text)), text, payload))


def stride_for(length: int, most: int) -> int:
    """Every so many pixels, so that no more than ``most`` are left."""
    return max(1, -(-length // most))


@dataclass(frozen=True, slots=True)
class FrameView:
    """A frame as viewers see it.

    Attributes:
        picture: uint8 (bands, samples), every so many; 255 means saturated, and nothing else does.
        facts: Statistics of the whole frame, plain JSON types.
    """

    picture: Bytes
    facts: dict[str, Any]


def view_frame(pixels: Pixels, previous: Pixels | None, bits: int) -> FrameView:
    """Make a frame visible.

    Args:
        pixels: (bands, samples) counts.
        previous: The frame before, of the same view, for the focus score.
        bits: Significant bits of a count.
    """
    top = (1 << bits) - 1
    by_band, by_sample = stride_for(pixels.shape[0], HEIGHT), stride_for(pixels.shape[1], WIDTH)
    small = pixels[::by_band, ::by_sample]
    picture = np.minimum(small >> (bits - 8) if bits > 8 else small, 254).astype(np.uint8)
    picture[small >= top] = 255
    table = _counts(pixels, top)
    histogram = table[: top + 1].reshape(BINS, -1).sum(axis=1)
    lit = np.flatnonzero(table)
    return FrameView(
        picture,
        {
            "bands": int(pixels.shape[0]),
            "samples": int(pixels.shape[1]),
            "stride": [by_band, by_sample],
            "full_scale": top,
            "histogram": histogram.tolist(),
            "saturated": int(table[top:].sum()),
            "maximum": int(lit[-1]),
            "mean": round(float(np.dot(table, np.arange(len(table)))) / pixels.size, 2),
            "spectrum": np.round(small.mean(axis=1), 1).tolist(),
            "profile": np.round(small.mean(axis=0), 1).tolist(),
            "focus": _focus(pixels, previous),
        },
    )


def _counts(pixels: Pixels, top: int) -> NDArray[np.int64]:
    """How often each count occurs: the quickest histogram, which gives maximum and saturation besides."""
    table = np.zeros(max(top + 1, int(np.iinfo(pixels.dtype).max) + 1), np.int64)
    for first in range(0, len(pixels), _ROWS):  # bincount makes 64-bit integers of all that it is given
        table += np.bincount(pixels[first : first + _ROWS].reshape(-1), minlength=len(table))
    return table


def _focus(pixels: Pixels, previous: Pixels | None) -> dict[str, float] | None:
    if previous is None or previous.shape != pixels.shape:
        return None
    middle = tuple(
        slice((length - min(size, length)) // 2, (length + min(size, length)) // 2)
        for length, size in zip(pixels.shape, _FOCUS, strict=True)
    )
    try:
        score = sharpness(np.stack([previous[middle], pixels[middle]]))
    except CalibrationError:
        return None
    return {"spatial": score.spatial, "spectral": score.spectral}


class RowMaker:
    """Turns lines into rows of a colour picture.

    Args:
        bands: Of a line.
        samples: Of a line.
        wavelength_nm: (bands,) where calibrated.
        bits: Significant bits of a count.
    """

    def __init__(self, bands: int, samples: int, wavelength_nm: NDArray[np.float64] | None, bits: int) -> None:
        weights = online_quicklook(bands, wavelength_nm).weights
        groups = np.add.reduceat(weights, np.arange(0, bands, _BAND_STRIDE), axis=1)
        self._weights = (groups / ((1 << bits) - 1)).astype(np.float32)
        self.by_sample = stride_for(samples, WIDTH)
        self.width = -(-samples // self.by_sample)
        middle = min(_BAND_STRIDE // 2, (bands - 1) % _BAND_STRIDE)
        self._bands = slice(middle, None, _BAND_STRIDE)

    def thin(self, pixels: Pixels) -> Pixels:
        """What of a line is needed, copied: quick, for the event loop."""
        return pixels[self._bands, :: self.by_sample].copy()

    def row(self, thin: Pixels) -> Bytes:
        """uint8 (width, 3): the square root of linear sRGB."""
        linear = self._weights @ thin.astype(np.float32)
        return (255 * np.sqrt(np.clip(linear, 0, 1))).astype(np.uint8).T
