"""Jitter, backlash and repeatability of the mirror, from cubes of the slanted lines."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from scanhsi.calibration.backlash import Backlash, backlash
from scanhsi.calibration.geometry import Geometry, Turn
from scanhsi.calibration.jitter import Jitter, jitter
from scanhsi.calibration.repeatability import Repeatability, repeatability
from scanhsi.calibration.shaft import find_turn
from scanhsi.calibration.slanted import displacements, repeated_displacements
from scanhsi.characterise.from_cubes import opened, provenance_of
from scanhsi.characterise.picture import TargetPicture, target_picture
from scanhsi.devices.errors import CalibrationError

Floats = NDArray[np.float64]
Path_ = str | Path

RUN_IN: Final = 16
"""Steps on which the mirror takes up the play of its drive."""

_UNWRAPPINGS: Final = 20
_SLOW: Final = 3  # degree of the curve that perspective bends even motion into


def jitter_from_cube(
    cube: Path_,
    *,
    slant_deg: float = 10.0,
    period_mm: float = 2.0,
    plane: Geometry | None = None,
    turn: Turn = None,
    harmonics: int = 2,
    run_in: int = RUN_IN,
) -> Jitter:
    """Jitter of every scan line, from a target of slanted lines (figure 8).

    Args:
        cube: Of the target, taken step by step around the normal.
        slant_deg: Of the target's lines from the slit.
        period_mm: Of the lines, across them.
        plane: The geometry as measured; the instrument file's by default.
        turn: Steps of a turn of the shaft that is out of true; ``"find"`` looks for it. None: as the geometry has it, else found.
        harmonics: Of that turn that are taken out.
        run_in: Steps at the beginning that are left out: there the mirror takes up the play.

    Raises:
        CalibrationError: No pattern; see `displacements` and `jitter`.
    """
    picture = target_picture(cube)
    begun = _begun(picture, run_in)
    seen, at = picture.values[begun], picture.steps[begun]
    plane = plane or picture.plane
    moved = displacements(seen, math.tan(math.radians(slant_deg)), plane.sample_pitch_mm)
    period = along_scan(slant_deg, period_mm)
    if turn is None and math.isfinite(plane.turn_steps):
        turn = plane.turn_steps
    steps = turn if isinstance(turn, float | int) else _found_turn(at, moved, period)
    if steps is None:
        harmonics = 0
    phase = 2 * np.pi * at / (steps or math.inf)
    moved, slow = _unwrapped(moved, phase, harmonics, period)
    return jitter(
        phase,
        moved - slow,
        picture.provenance,
        harmonics=harmonics,
        fitted=_SLOW,
        turn_steps=math.nan if steps is None else float(steps),
    )


def along_scan(slant_deg: float, period_mm: float) -> float:
    """Period in mm along the scan of lines whose period across them is given."""
    return period_mm / math.cos(math.radians(slant_deg))


def _found_turn(steps: Floats, moved: Floats, period_mm: float) -> float | None:
    moved, _ = _unwrapped(moved, np.zeros(len(moved)), 0, period_mm)
    return find_turn(steps, moved, slow=_SLOW)


def _unwrapped(moved: Floats, phase: Floats, harmonics: int, period_mm: float) -> tuple[Floats, Floats]:
    """Displacements that went over half a period put back, and the slow part of them, which is perspective.

    A line that lies off by more than half a period looks like one on the other side. What is slow or periodic is fitted and
    everything put to where it is nearest to that, until nothing moves any more.
    """
    line = np.linspace(-1, 1, len(moved))
    slowly = np.stack([line**power for power in range(_SLOW + 1)], axis=1)
    waves = [wave(order * phase) for order in range(1, harmonics + 1) for wave in (np.cos, np.sin)]
    design = np.concatenate([slowly, *(wave[:, None] for wave in waves)], axis=1)
    coefficients = np.zeros(design.shape[1])
    for _ in range(_UNWRAPPINGS):
        coefficients = np.linalg.lstsq(design, moved, rcond=1e-9)[0]
        fitted = design @ coefficients
        before, moved = moved, fitted + (moved - fitted + period_mm / 2) % period_mm - period_mm / 2
        if np.array_equal(np.round(moved - before, 6), np.zeros(len(moved))):
            break
    return moved, slowly @ coefficients[: _SLOW + 1]


def backlash_from_cubes(cubes: Sequence[Path_], *, plane: Geometry | None = None, run_in: int = RUN_IN) -> Backlash:
    """Backlash, from scans upwards and as many downwards over the same target.

    Args:
        cubes: Two or more, in any order: they say themselves which way they went.
        plane: The geometry as measured; the instrument file's by default.
        run_in: Steps at the beginning of each that are left out: there the mirror takes up the play.

    Raises:
        CalibrationError: Not as many upwards as downwards, or hardly a step in common; see `backlash`.
    """
    pictures = [target_picture(cube) for cube in cubes]
    ups, downs = _ways(pictures)
    common = pictures[0].steps
    for picture in pictures:
        common = np.intersect1d(common, picture.steps[_begun(picture, run_in)])
    if not common.size:
        raise CalibrationError("the scans have no step in common, besides where they begin.")
    step_mm = _step_mm(plane or pictures[0].plane)
    return backlash(_at(ups, common), _at(downs, common), common, step_mm, provenance_of(opened(cubes), cubes))


def _begun(picture: TargetPicture, run_in: int) -> NDArray[np.bool_]:
    """Lines beyond those on which the mirror took up the play."""
    low, high = (run_in, 0) if picture.upwards else (0, run_in)
    return (picture.steps >= picture.steps[0] + low) & (picture.steps <= picture.steps[-1] - high)


def _ways(pictures: Sequence[TargetPicture]) -> tuple[list[TargetPicture], list[TargetPicture]]:
    """Those taken upwards and those downwards, as many of each."""
    ups = [picture for picture in pictures if picture.upwards]
    downs = [picture for picture in pictures if not picture.upwards]
    if not ups or len(ups) != len(downs):
        raise CalibrationError(
            f"as many scans upwards as downwards are needed, not {len(ups)} and {len(downs)}.",
            hint="scan with step=1 and with step=-1",
        )
    return ups, downs


def _at(pictures: Sequence[TargetPicture], steps: Floats) -> list[Floats]:
    """What they saw at some steps, (line, sample) each."""
    return [picture.values[np.isin(picture.steps, steps)] for picture in pictures]


def repeatability_from_cubes(
    cubes: Sequence[Path_], *, slant_deg: float = 10.0, period_mm: float = 2.0, plane: Geometry | None = None
) -> Repeatability:
    """Repeatability, from scans of the slanted lines over the same steps, as many upwards as downwards.

    The first line of each is left out: on the way to it the mirror takes up the play. Whether a deviation is to higher or to lower
    steps is told by a target that lies as asked for: its lines rise along the scan as they go along the slit.

    Args:
        cubes: Three in either direction or more, in any order.
        slant_deg: Of the target's lines from the slit.
        period_mm: Of the lines, across them.
        plane: The geometry as measured; the instrument file's by default.

    Raises:
        CalibrationError: Other steps from scan to scan; see `repeated_displacements` and `repeatability`.
    """
    pictures = [target_picture(cube) for cube in cubes]
    ups, downs = _ways(pictures)
    common = _common_steps(pictures)
    plane = plane or pictures[0].plane
    moved = repeated_displacements(_at(ups, common), _at(downs, common))
    slope = plane.y_mm(common + 0.5) - plane.y_mm(common - 0.5)  # mm a step, with its sign
    up, down = (one * along_scan(slant_deg, period_mm) / slope for one in moved)
    return repeatability(up, down, common, _step_mm(plane), provenance_of(opened(cubes), cubes))


def _common_steps(pictures: Sequence[TargetPicture]) -> Floats:
    """Steps that all scans have, their first lines left out."""
    common = pictures[0].steps
    for picture in pictures:
        common = np.intersect1d(common, picture.steps[1:] if picture.upwards else picture.steps[:-1])
    return common


def _step_mm(plane: Geometry) -> float:
    return float(plane.line_pitch_mm(plane.normal_step))
