"""A pattern that tells, in every single pixel, whether it is the right one of the right line.

A pixel is ``BAND * band + SAMPLE * sample + STEP * step`` modulo 2**bits, with band and sample counted on the whole sensor.
The factors are odd, so a step can be read back, and chosen so that no shift shorter than 6 (8 bit) or 16 (12 bit) in
(band, sample, step) maps the pattern onto itself: a frame that is shifted, or of another line, is wrong in *every* pixel.

Real motion blur of this pattern could look like another step. So a frame during which the mirror moved is marked instead: half
the range is added to even samples, a quarter to odd ones. It equals no unmarked frame of the span, anywhere.
"""

from dataclasses import dataclass

import numpy as np

from scanhsi_sim.scenes.base import Image

BAND, SAMPLE, STEP = 1091, 2159, 3533


@dataclass(frozen=True)
class Decoded:
    """What a frame of the test pattern says.

    Attributes:
        step: Mirror step, or the first one if the mirror moved, modulo 2**bits.
        moved: Whether the mirror moved during the exposure.
    """

    step: int
    moved: bool


def expected(
    step: int, shape: tuple[int, int], offset: tuple[int, int] = (0, 0), bits: int = 12, *, moved: bool = False
) -> Image:
    """The frame at a mirror step; with `moved`, of an exposure that began there and during which the mirror moved.

    Args:
        step: Mirror step.
        shape: (bands, samples).
        offset: (band, sample) of the first pixel on the sensor.
        bits: 8 or 12.
        moved: See above.
    """
    band = BAND * (np.arange(shape[0]) + offset[0])
    sample = SAMPLE * (np.arange(shape[1]) + offset[1])
    if moved:
        sample += np.where((np.arange(shape[1]) + offset[1]) % 2 == 0, 1 << (bits - 1), 1 << (bits - 2))
    pattern = (band[:, None] + sample[None, :] + STEP * step) & ((1 << bits) - 1)
    return pattern.astype(np.uint8 if bits == 8 else np.uint16)


def decode(frame: Image, offset: tuple[int, int] = (0, 0), bits: int = 12) -> Decoded:
    """Read the mirror step out of a frame of at least two samples.

    Raises:
        ValueError: The pixels do not agree: the frame is torn, shifted or damaged; the message says where.
    """
    shape = (frame.shape[0], frame.shape[1])
    mask = (1 << bits) - 1
    step = _step_of(int(frame[0, 0]), int(expected(0, (1, 1), offset, bits)[0, 0]), mask)
    if np.array_equal(frame, expected(step, shape, offset, bits)):
        return Decoded(step, moved=False)
    moved = _step_of(int(frame[0, 0]), int(expected(0, (1, 1), offset, bits, moved=True)[0, 0]), mask)
    if np.array_equal(frame, expected(moved, shape, offset, bits, moved=True)):
        return Decoded(moved, moved=True)
    wrong = frame != expected(step, shape, offset, bits)
    band, sample = (int(place) for place in np.argwhere(wrong)[0])
    raise ValueError(
        f"not a frame of the test pattern: of step {step}, which its first pixel shows, {int(wrong.sum())} of {wrong.size} "
        f"pixels differ, the first at band {band}, sample {sample}"
    )


def _step_of(pixel: int, pixel_at_step_0: int, mask: int) -> int:
    return (pixel - pixel_at_step_0) * pow(STEP, -1, mask + 1) & mask


class TestPattern:
    """The test pattern as a scene. Exposure and gain change nothing."""

    __test__ = False  # not a test class, whatever pytest thinks of the name

    def __init__(self, sensor: tuple[int, int]) -> None:
        self._sensor = sensor
        self._bases: dict[tuple[int, bool], Image] = {}

    def render(
        self,
        step_start: float,
        step_end: float,
        *,
        exposure_s: float,
        gain_db: float,
        shape: tuple[int, int],
        offset: tuple[int, int],
        bits: int,
        index: int,
        acquisition: int = 0,
        time_s: float = 0.0,
    ) -> Image:
        """One frame: a table of the whole sensor plus one number, modulo 2**bits; about 1 ms."""
        del exposure_s, gain_db, index, acquisition, time_s
        base = self._base(bits, step_end != step_start)
        base = base[offset[0] : offset[0] + shape[0], offset[1] : offset[1] + shape[1]]
        mask = (1 << bits) - 1
        shift = base.dtype.type(STEP * round(step_start) & mask)
        frame = base + shift  # uint8 wraps as it should
        if bits != 8:
            frame &= base.dtype.type(mask)
        return frame

    def _base(self, bits: int, moved: bool) -> Image:
        key = bits, moved
        if key not in self._bases:  # two threads may both make it, alike
            self._bases[key] = expected(0, self._sensor, bits=bits, moved=moved)
        return self._bases[key]
