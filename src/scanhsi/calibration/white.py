"""White reference: what a tile of known reflectance gives, pixel by pixel, with its dark signal and its uncertainty."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray

from scanhsi.calibration.frames import FrameStack
from scanhsi.calibration.reference import Reference
from scanhsi.calibration.result import Provenance, Stored
from scanhsi.devices.errors import CalibrationError

Floats = NDArray[np.float64]

_PIXEL = ("band", "sample")


@dataclass(frozen=True, slots=True, eq=False)
class WhiteReference:
    """Mean counts of a white tile.

    Attributes:
        mean: Counts as the camera gave them; nan where saturated in any frame, (band, sample).
        dark: Dark counts of the same exposure, (band, sample).
        sigma: Standard error of ``mean``, (band, sample).
        saturated: Pixels without a value for that reason, (band, sample).
        level: Counts from which a pixel is saturated.
        tile: Reflectance of the tile.
        lines: Frames averaged.
        provenance: Where it comes from; its conditions say the exposure.
    """

    kind: ClassVar[str] = "white"

    mean: Annotated[Floats, Stored("counts", "white counts", _PIXEL)]
    dark: Annotated[Floats, Stored("counts", "dark counts of the same exposure", _PIXEL)]
    sigma: Annotated[Floats, Stored("counts", "standard error of the white counts", _PIXEL)]
    saturated: Annotated[NDArray[np.bool_], Stored("1", "saturated", _PIXEL)]
    level: Annotated[float, Stored("counts", "saturated from here on; nan where not known")]
    tile: Annotated[float, Stored("1", "reflectance of the tile")]
    lines: Annotated[int, Stored("1", "frames averaged")]
    provenance: Provenance

    @property
    def exposure_s(self) -> float | None:
        """Exposure of the tile."""
        return self.provenance.conditions.exposure_s

    def references(self, source: str) -> tuple[Reference, Reference]:
        """White and dark as references of processing steps, named after the file they come from."""
        conditions = self.provenance.conditions
        white, dark = (values.astype(np.float32) for values in (self.mean, self.dark))
        return Reference(source, white, self.lines, conditions), Reference(source, dark, self.lines, conditions)


def white_reference(white: FrameStack, dark: Reference, provenance: Provenance, *, tile: float) -> WhiteReference:
    """Make the white reference of a tile.

    Args:
        white: Frames of the tile.
        dark: Dark reference of the same exposure.
        provenance: Where they come from.
        tile: Reflectance of the tile, 0 to 1.5.

    Raises:
        CalibrationError: Taken under other conditions than the dark reference, a single frame, no light, or saturated all over.
    """
    if wrong := white.conditions.differences(dark.conditions):
        raise CalibrationError(f"{dark.source} is no dark reference for {white.source}: {', '.join(wrong)}.")
    if white.mean.shape != dark.mean.shape:
        raise CalibrationError(f"white frames of {white.mean.shape} and dark ones of {dark.mean.shape} do not fit.")
    if white.lines < 2:
        raise CalibrationError(f"{white.source} holds a single line, which tells no noise; take 20.")
    if not np.isfinite(white.mean).all():
        raise CalibrationError(f"{white.source} holds values that are no numbers.")
    if not 0 < tile <= 1.5:
        raise CalibrationError(f"a tile cannot have a reflectance of {tile:g}.")
    if white.saturated.mean() > 0.5:
        raise CalibrationError(
            f"{100 * white.saturated.mean():.0f} % of {white.source} is saturated.", hint="a shorter exposure"
        )
    signal = white.mean - dark.mean
    error = np.where(np.isfinite(white.sigma), white.sigma, 0) / np.sqrt(white.lines)
    if not float(np.nanmedian(signal)) > 3 * float(np.median(error)):
        raise CalibrationError(f"{white.source} shows no light above its dark reference.", hint="is the lamp on?")
    return WhiteReference(
        mean=np.where(white.saturated, np.nan, white.mean),
        dark=dark.mean.astype(np.float64),
        sigma=error,
        saturated=white.saturated,
        level=np.nan if white.level is None else float(white.level),
        tile=tile,
        lines=white.lines,
        provenance=replace(provenance, conditions=white.conditions),
    )
