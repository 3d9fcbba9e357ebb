"""A cube of a target as a picture: the mean of the bands, dark-free where that is known, and where its lines were taken."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scanhsi.calibration.frames import frames_of, stored_lines
from scanhsi.calibration.geometry import Geometry
from scanhsi.calibration.result import Provenance
from scanhsi.characterise.from_cubes import opened, provenance_of
from scanhsi.devices.errors import CalibrationError

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class TargetPicture:
    """A cube of a flat target.

    Attributes:
        values: Mean counts of the bands that are lit best, (line, sample).
        steps: Mirror steps of the lines, rising, (line,).
        upwards: Whether they were taken in this order; the other way round otherwise.
        plane: The object plane as the instrument file has it: where a fit begins.
        provenance: Where it comes from.
    """

    values: Floats
    steps: Floats
    upwards: bool
    plane: Geometry
    provenance: Provenance


def target_picture(cube: str | Path) -> TargetPicture:
    """Read a cube as a picture.

    Raises:
        CalibrationError: It holds no raw counts, or does not know its geometry.
    """
    dataset = opened([cube])[0]
    provenance = provenance_of([dataset], [cube])
    lines = [frame.mean(axis=0, dtype=np.float64) for frame in frames_of(dataset, str(cube))]
    steps = np.asarray(dataset["mirror_step"].values, np.float64)[stored_lines(dataset, str(cube))]
    order = np.argsort(steps, kind="stable")
    plane = _plane(dataset, str(cube), provenance)
    return TargetPicture(np.stack(lines)[order], steps[order], bool(steps[-1] >= steps[0]), plane, provenance)


def _plane(dataset: xr.Dataset, name: str, provenance: Provenance) -> Geometry:
    instrument = cast("dict[str, Any]", dataset.attrs.get("instrument") or {})
    geometry = cast("dict[str, Any]", instrument.get("geometry") or {})
    if not geometry:
        raise CalibrationError(f"{name} does not know the geometry of its instrument.")
    roi = cast("dict[str, int]", instrument.get("roi") or {})
    devices = cast("dict[str, Any]", dataset.attrs.get("devices") or {})
    sensor = cast("dict[str, Any]", devices.get("camera") or {}).get("samples", dataset.sizes["sample"])
    pitch = geometry.get("sample_pitch_m")
    return Geometry(
        distance_mm=1000 * float(geometry["distance_m"]),
        normal_step=float(geometry["normal_step"]),
        step_rad=float(geometry["scan_direction"]) * 2 * np.pi / float(geometry["steps_per_revolution"]),
        sample_pitch_mm=np.nan if pitch is None else 1000 * float(pitch),
        principal_sample=(int(sensor) - 1) / 2 - int(roi.get("sample_offset", 0)),
        provenance=provenance,
    )
