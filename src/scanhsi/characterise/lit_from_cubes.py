"""Frames of something lit, less their dark signal and without hot pixels: what the spectrograph's calibrations begin with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from scanhsi.calibration.dark import DarkModel
from scanhsi.calibration.frames import FrameStack, stack_frames
from scanhsi.calibration.result import Provenance
from scanhsi.characterise.from_cubes import check_dark, opened, provenance_of, split_by_target
from scanhsi.devices.errors import CalibrationError

Floats = NDArray[np.float64]
Path_ = str | Path

_HOT: Final = 10.0  # robust standard deviations of the dark signal
_NEAR: Final = 3  # samples to either side that stand in for a hot one


@dataclass(frozen=True, slots=True, eq=False)
class Lit:
    """Frames of something lit.

    Attributes:
        frames: Mean of each, less its dark signal, hot pixels by their neighbours, nan where saturated, (band, sample); by the
            target that its cube names.
        provenance: Of all cubes.
    """

    frames: dict[str, Floats]
    provenance: Provenance

    def only(self, what: str) -> Floats:
        """The one frame.

        Raises:
            CalibrationError: There are none, or several.
        """
        if len(self.frames) != 1:
            raise CalibrationError(f"one cube of {what} is needed, and its dark signal; not {len(self.frames)}.")
        return next(iter(self.frames.values()))


def lit_frames(cubes: Sequence[Path_], dark: DarkModel | None) -> Lit:
    """Read cubes of things lit.

    Args:
        cubes: One a target, and where there is no model a dark one of the same exposure.
        dark: Dark model instead.

    Raises:
        CalibrationError: Two cubes of one target, no dark signal, or one of another exposure, gain or region.
    """
    below, lit = ([], list(cubes)) if dark is not None else split_by_target(cubes)
    datasets = opened(cubes)
    known = {stack.conditions.exposure_s: stack.mean for stack in map(stack_frames, below)}
    frames: dict[str, Floats] = {}
    for cube in lit:
        stack = stack_frames(cube)
        exposure_s = stack.conditions.exposure_s
        if dark is not None:
            check_dark(dark, stack.conditions)
            if exposure_s is None:
                raise CalibrationError(f"{cube} does not say at which exposure it was taken.")
            black, hot = dark.at(exposure_s), dark.hot
        elif exposure_s not in known:
            raise CalibrationError(f"the dark cube of the exposure of {cube} is needed, or a dark model.")
        else:
            black = known[exposure_s]
            hot = _hot(black)
        name = str(opened([cube])[0].attrs.get("target", cube))
        if name in frames:
            raise CalibrationError(f"there are two cubes of {name}; one is needed.")
        frames[name] = _corrected(stack, black, hot)
    return Lit(frames, provenance_of(datasets, cubes))


def _hot(dark: Floats) -> NDArray[np.bool_]:
    median = float(np.median(dark))
    spread = 1.4826 * float(np.median(np.abs(dark - median)))
    return np.abs(dark - median) > _HOT * max(spread, 0.5)


def _corrected(stack: FrameStack, black: Floats, hot: NDArray[np.bool_]) -> Floats:
    frame = stack.mean - black
    frame[stack.saturated] = np.nan
    frame[hot] = np.nan
    for band, sample in np.argwhere(hot).tolist():
        near = frame[band, max(0, sample - _NEAR) : sample + _NEAR + 1]
        near = near[np.isfinite(near)]
        if near.size:
            frame[band, sample] = near.mean()
    return frame
