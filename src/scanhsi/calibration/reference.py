"""Dark and white references: the mean line of a cube, or what a dark model says of an exposure."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanhsi.calibration.conditions import Conditions
from scanhsi.calibration.dark import DarkModel
from scanhsi.calibration.frames import stack_frames
from scanhsi.devices.errors import CalibrationError


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """The mean line of a reference cube.

    Attributes:
        source: The cube it was made from.
        mean: (band, sample) float32, counts; nan where a pixel was saturated in any line.
        lines: Number of lines averaged.
        conditions: Under which it was taken.
    """

    source: str
    mean: NDArray[np.float32]
    lines: int
    conditions: Conditions

    def describe(self) -> dict[str, Any]:
        """What provenance says of it."""
        return {"source": self.source, "lines": self.lines, "exposure_s": self.conditions.exposure_s}


@dataclass(frozen=True, slots=True, eq=False)
class ModelledDark:
    """A dark model that stands in for a dark reference, at whatever exposure is asked for.

    Attributes:
        source: Its file.
        model: The model.
    """

    source: str
    model: DarkModel

    def at(self, exposure_s: float | None) -> Reference:
        """The dark reference of an exposure.

        Raises:
            CalibrationError: The exposure is not known, or longer than the model knows.
        """
        if exposure_s is None:
            raise CalibrationError(
                f"{self.source} gives the dark signal of an exposure, and the cube does not say which one it had.",
                hint="a dark cube taken like the raw one",
            )
        mean = self.model.at(exposure_s).astype(np.float32)
        conditions = replace(self.model.provenance.conditions, exposure_s=exposure_s)
        return Reference(self.source, mean, self.model.frames, conditions)


def average(path: str | Path, *, saturation: float | None = None) -> Reference:
    """Average the stored lines of a cube of raw counts, in one pass and bounded memory.

    Args:
        path: The cube.
        saturation: Counts from which a pixel is saturated; None looks for a plateau below full scale, else takes full scale.

    Raises:
        NotACube, CubeError: It cannot be read.
        CalibrationError: It holds no line.
    """
    stack = stack_frames(path, saturation=saturation)
    mean = stack.mean.astype(np.float32)
    mean[stack.saturated] = np.nan
    return Reference(stack.source, mean, stack.lines, stack.conditions)
