"""One figure a calibration."""

from __future__ import annotations

from pathlib import Path

from scanhsi.calibration.figures import mirror, optics, sensor, wavelength
from scanhsi.calibration.figures.style import save_figure
from scanhsi.calibration.result import Result

FIGURES = {**sensor.FIGURES, **optics.FIGURES, **mirror.FIGURES, **wavelength.FIGURES}
"""Kind of a result -> what draws it."""


def draw(result: Result, path: str | Path) -> Path | None:
    """Draw the figure of a result.

    Args:
        result: Of any kind.
        path: ``.png``, ``.pdf`` or ``.svg``.

    Returns:
        The path; None for a kind that has no figure.

    Raises:
        CalibrationError: The file cannot be written.
    """
    found = FIGURES.get(result.kind)
    return None if found is None else save_figure(lambda: found(result), Path(path))
