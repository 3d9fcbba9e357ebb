"""The work: lines of the camera through dark, white, smile and binning to reflectance."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from scanhsi.calibration.conditions import Conditions
from scanhsi.calibration.reference import Reference
from scanhsi.calibration.result import Provenance
from scanhsi.calibration.smile import Smile
from scanhsi.cube.layout import CubeSpec
from scanhsi.cube.records import LineRecords
from scanhsi.cube.writer import CubeWriter
from scanhsi.processing import BinBands, CorrectSmile, MaskSaturated, Pipeline, Reflectance, Signal, Step, SubtractDark

FULL_RATE: Final = 49.5
"""Lines a second: the camera's most."""

BIN: Final = 5
_DARK, _WHITE = 60.0, 3000.0
_NOTHING: Final = np.zeros(0)


@dataclass(frozen=True, slots=True)
class Size:
    """Of the raw cube."""

    lines: int = 1200
    bands: int = 1088
    samples: int = 1200

    @property
    def spec(self) -> CubeSpec:
        """Of the raw cube."""
        return CubeSpec(
            self.lines, self.bands, self.samples, np.uint16, 12, wavelength_nm=np.linspace(371, 948, self.bands)
        )

    @property
    def line_bytes(self) -> int:
        """Of a raw line."""
        return 2 * self.bands * self.samples

    @property
    def raw_bytes(self) -> int:
        """Of the raw pixels."""
        return self.lines * self.line_bytes


def references(size: Size) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Dark and white counts, (band, sample)."""
    rng = np.random.default_rng(2)
    shape = (size.bands, size.samples)
    return tuple((level + 5 * rng.standard_normal(shape)).astype(np.float32) for level in (_DARK, _WHITE))  # pyright: ignore[reportReturnType] - two


def chain(size: Size) -> list[Step]:
    """Mask, dark, white, cubic smile of up to a band, bins of five."""
    dark, white = (
        Reference(name, counts, 20, Conditions())
        for name, counts in zip(("dark", "white"), references(size), strict=True)
    )
    smile = Smile(
        bands=size.bands,
        samples=size.samples,
        reference_sample=(size.samples - 1) / 2,
        coefficients=np.array([[0.2, 0.8], [0.02, 0.05]]),
        coefficients_sigma=np.zeros((2, 2)),
        residual_bands=0.0,
        line_nm=_NOTHING,
        block=_NOTHING,
        line_band=_NOTHING[None],
        line_fwhm_nm=_NOTHING[None],
        provenance=Provenance(("made up",)),
    )
    return [MaskSaturated(), SubtractDark(dark), Reflectance(white, dark, 0.99), CorrectSmile(smile), BinBands(BIN)]


def pipeline(size: Size) -> Pipeline:
    """The chain, bound."""
    return Pipeline(Signal.of_spec(size.spec), chain(size))


def line_of(frames: NDArray[np.uint16], line: int) -> NDArray[np.uint16]:
    """A (band, sample) line: the frames in turn, shifted along the slit each time round."""
    return np.roll(frames[line % len(frames)], line // len(frames), axis=1)


@dataclass(frozen=True, slots=True)
class Paced:
    """How lines were taken that came at a rate.

    Attributes:
        late_p99_ms, late_max_ms: After it was due a line was taken.
        wall_s: From the first line to the cube closed.
    """

    late_p99_ms: float
    late_max_ms: float
    wall_s: float


async def write(
    path: Path, size: Size, frames: NDArray[np.uint16], rate: float | None = None, *, roll: bool = True
) -> Paced:
    """Write the raw cube, at a rate or as fast as it goes."""
    writer = CubeWriter(path, size.spec)
    await writer.open(LineRecords(size.lines))
    late = np.zeros(size.lines)
    start = time.perf_counter()
    for line in range(size.lines):
        due = start + line / rate if rate else time.perf_counter()
        await asyncio.sleep(max(0.0, due - time.perf_counter()))
        buffer = writer.buffer(line)
        assert buffer is not None, "it stores"
        np.copyto(buffer, line_of(frames, line) if roll else frames[line % len(frames)])
        await writer.append(line)
        late[line] = time.perf_counter() - due
    await writer.flush()
    await writer.close()
    p99, worst = float(np.percentile(late, 99)), float(late.max())
    return Paced(1e3 * p99, 1e3 * worst, time.perf_counter() - start)


def repeat(do: Callable[[], Any], least_s: float = 2.0, least: int = 3) -> float:
    """Seconds of the quickest of some repetitions."""
    best, passed, done = np.inf, 0.0, 0
    while passed < least_s or done < least:
        began = time.perf_counter()
        do()
        took = time.perf_counter() - began
        best, passed, done = min(best, took), passed + took, done + 1
    return best
