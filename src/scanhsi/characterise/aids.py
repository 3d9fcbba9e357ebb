"""Aids for setting an instrument up: the exposure of a white tile, and how sharp it sees."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from scanhsi.characterise.look import look
from scanhsi.devices.errors import CalibrationError

if TYPE_CHECKING:
    from scanhsi.characterise.station import Scans

Floats = NDArray[np.float64]

_TARGET: Final = 0.85
_CLOSE: Final = 0.03
_DARK: Final = 0.1  # of full scale at the longest exposure: no tile is so dark
_TRIES: Final = 8
_BRIGHTEST: Final = 0.999  # of the pixels: a hot one is not the tile


@dataclass(frozen=True, slots=True)
class FoundExposure:
    """An exposure that uses the camera's range and saturates nothing that counts.

    Attributes:
        exposure_s: Exposure time.
        level: Brightest counts at it (99.9th percentile), as a share of full scale.
        saturated: Share of pixels at full scale.
        limited: The camera allows no longer (or shorter) one: the tile stays darker (or brighter) than wanted.
        frames: Frames it took to find.
    """

    exposure_s: float
    level: float
    saturated: float
    limited: bool
    frames: int


async def auto_exposure(
    imager: Scans, *, target: float = _TARGET, start_s: float | None = None, black: float = 0.0
) -> FoundExposure:
    """Find the exposure at which what is before the instrument, a white tile, is almost as bright as the camera can tell.

    Counts grow with the exposure in proportion, so two or three frames do; saturated ones only tell that it is less, and the
    exposure is quartered. Gain is left as the instrument file has it: more gain is more noise.

    Args:
        imager: The instrument.
        target: Wanted level of the brightest pixels, as a share of full scale.
        start_s: Where to begin; None takes the instrument file's exposure.
        black: Counts without light, as a share of full scale.

    Raises:
        CalibrationError: It is dark, or the level does not follow the exposure.
        ScanFailed: A frame could not be taken.
    """
    if not 0.05 <= target <= 0.98:
        raise CalibrationError(f"a level of {target:g} of full scale cannot be aimed at; 0.05 to 0.98 can.")
    allowed = imager.instrument.camera_info.exposure
    plan = imager.default_plan()
    top = (1 << plan.pixel_format.bits) - 1
    exposure = min(max(start_s or plan.exposure_s, allowed.minimum), allowed.maximum)
    for tried in range(1, _TRIES + 1):
        frame = (await look(imager, exposure_s=exposure))[0]
        level, saturated = _brightest(frame) / top, np.count_nonzero(frame >= top) / frame.size
        wanted = exposure / 4 if level >= 0.999 else exposure * (target - black) / max(level - black, 1e-4)
        following = min(max(wanted, allowed.minimum), allowed.maximum)
        if abs(level - target) <= _CLOSE or following == exposure:
            if level < _DARK:
                break
            return FoundExposure(exposure, level, saturated, abs(level - target) > _CLOSE, tried)
        exposure = following
    else:
        raise CalibrationError(f"the brightness does not settle: {level:.2f} of full scale at {exposure:g} s.")  # pyright: ignore[reportPossiblyUnboundVariable] the loop ran
    raise CalibrationError("there is no light.", hint="is the lamp on, the shutter open, the tile in view?")


def _brightest(frame: NDArray[Any]) -> float:
    values = np.sort(frame, axis=None)
    return float(values[int(_BRIGHTEST * (values.size - 1))])


@dataclass(frozen=True, slots=True)
class Sharpness:
    """How sharp a frame is; larger is sharper. Only to be compared with others of the same scene.

    Attributes:
        spatial: Of edges along the slit: mean squared slope over squared mean, noise of the pixels left out.
        spectral: The same along the spectrum.
    """

    spatial: float
    spectral: float


def sharpness(frames: NDArray[Any]) -> Sharpness:
    """Sharpness of what frames have in common.

    The slope is taken from two different frames and multiplied, so that noise, which they do not share, does not look sharp.

    Args:
        frames: (frame, band, sample) counts, two or more of the same view.

    Raises:
        CalibrationError: Fewer than two frames, or no light.
    """
    if frames.ndim != 3 or len(frames) < 2:
        raise CalibrationError(f"sharpness needs two frames of the same view, not {frames.shape}.")
    first: Floats = frames[::2].mean(axis=0, dtype=np.float64)
    second: Floats = frames[1::2].mean(axis=0, dtype=np.float64)
    level = float(first.mean()) ** 2
    if not level > 0:
        raise CalibrationError("there is no light.")

    def slopes(axis: int) -> float:
        here, there = (np.moveaxis(mean, axis, 0) for mean in (first, second))
        product: Floats = (here[1:] - here[:-1]) * (there[1:] - there[:-1])
        return float(product.mean()) / level

    return Sharpness(spatial=slopes(1), spectral=slopes(0))


async def focus_score(imager: Scans, *, exposure_s: float | None = None, frames: int = 4) -> Sharpness:
    """Sharpness of what is before the instrument now: turn the lens, call it again, keep what scores highest.

    Raises:
        ScanFailed, CalibrationError: As scans and `sharpness` do.
    """
    exposure = imager.default_plan().exposure_s if exposure_s is None else exposure_s
    return sharpness(await look(imager, exposure_s=exposure, frames=frames))
