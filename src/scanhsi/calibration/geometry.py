"""Where a line and a sample lie in the object plane: the model of a rotating mirror, and its fit to a grid (Eqs. 5-13, figure 7).

A mirror step turns the view by twice the step's angle. With the optical angle ``gamma = 2 dtheta (k - k0)`` from the normal
of a plane at distance ``r``, a line lies at ``y = -r tan(gamma)`` (Eqs. 8, 12) and a sample at ``x = (s - s0) dx / cos(gamma)``
(Eq. 9, with the principal column s0 that the paper leaves out). A plane that is tilted by ``tilt`` about the slit's direction is
met at ``y = -r sin(gamma) / cos(gamma + tilt)`` along it. A shaft of the drive that is out of true moves the mirror to and fro
with each of its turns: to the step k come ``c cos(2 pi k / turn) + s sin(2 pi k / turn)``. A plane that is turned about the
direction of the scan is not modelled.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar, Final, Literal, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import optimize

from scanhsi.calibration.result import Provenance, Stored
from scanhsi.calibration.shaft import find_turn
from scanhsi.devices.errors import CalibrationError

Floats = NDArray[np.float64]
Turn = float | Literal["find"] | None
"""Steps of a turn of the shaft that is out of true, ``"find"`` to look for it, or None."""

_LINEAR_GAMMA_RAD: Final = math.pi / 8  # Eq. 13
_STEEPEST_RAD: Final = math.radians(60)  # beyond, the tangent magnifies whatever is wrong
_OUTLIER_MM: Final = 0.5
_LEAST_POINTS: Final = 5
_INVERSIONS: Final = 12  # the error of a shaft changes by some percent of a step from step to step


@dataclass(frozen=True, slots=True, eq=False)
class Geometry:
    """The object plane as seen by the mirror.

    Attributes:
        distance_mm, distance_sigma_mm: From the mirror's axis to the plane, with its standard error.
        normal_step, normal_sigma_steps: Step, with fractions, at which the view is normal to the plane.
        tilt_rad, tilt_sigma_rad: Of the plane about the slit's direction.
        step_rad: Turn of the mirror a step; the view turns by twice of it. Its sign is the direction of the scan.
        sample_pitch_mm: Distance of samples at the normal.
        principal_sample: Sample that looks straight.
        residual_mm: Standard deviation of the points around the model; nan where nothing was fitted.
        points: Points fitted.
        turn_steps: Steps of a turn of the shaft that is out of true; nan where none is known to be.
        shaft_cos_steps, shaft_sin_steps: By how much it is, in mirror steps.
        shaft_sigma_steps: Standard error of either.
        provenance: Where it comes from.
    """

    kind: ClassVar[str] = "geometry"

    distance_mm: Annotated[float, Stored("mm", "distance of the object plane")]
    normal_step: Annotated[float, Stored("steps", "step that looks straight at the plane")]
    step_rad: Annotated[float, Stored("rad", "turn of the mirror a step")]
    sample_pitch_mm: Annotated[float, Stored("mm", "distance of samples at the normal")]
    principal_sample: Annotated[float, Stored("1", "sample that looks straight")]
    provenance: Provenance
    tilt_rad: Annotated[float, Stored("rad", "tilt of the plane about the slit")] = 0.0
    distance_sigma_mm: Annotated[float, Stored("mm", "standard error of the distance")] = math.nan
    normal_sigma_steps: Annotated[float, Stored("steps", "standard error of the normal step")] = math.nan
    tilt_sigma_rad: Annotated[float, Stored("rad", "standard error of the tilt")] = math.nan
    residual_mm: Annotated[float, Stored("mm", "standard deviation around the model")] = math.nan
    points: Annotated[int, Stored("1", "points fitted")] = 0
    turn_steps: Annotated[float, Stored("steps", "turn of the shaft out of true")] = math.nan
    shaft_cos_steps: Annotated[float, Stored("steps", "error of that shaft, cosine of its turn")] = 0.0
    shaft_sin_steps: Annotated[float, Stored("steps", "error of that shaft, sine of its turn")] = 0.0
    shaft_sigma_steps: Annotated[float, Stored("steps", "standard error of either")] = math.nan

    @property
    def shaft_steps(self) -> float:
        """Amplitude of the error of the shaft that is out of true."""
        return math.hypot(self.shaft_cos_steps, self.shaft_sin_steps)

    def _seen(self, step: Floats) -> Floats:
        """Where the mirror is when it was sent to a step."""
        if not math.isfinite(self.turn_steps):
            return step
        turn = 2 * np.pi * step / self.turn_steps
        return step + self.shaft_cos_steps * np.cos(turn) + self.shaft_sin_steps * np.sin(turn)

    def gamma_rad(self, step: ArrayLike) -> Floats:
        """Angle of the view from the normal."""
        return 2 * self.step_rad * (self._seen(np.asarray(step, np.float64)) - self.normal_step)

    def y_mm(self, step: ArrayLike) -> Floats:
        """Where a line lies along the scan."""
        gamma = self.gamma_rad(step)
        return -self.distance_mm * np.sin(gamma) / np.cos(gamma + self.tilt_rad)

    def step_of(self, y_mm: ArrayLike) -> Floats:
        """Step, with fractions, that looks at a place: the inverse of `y_mm`."""
        y = np.asarray(y_mm, np.float64)
        gamma = -np.arctan2(y * math.cos(self.tilt_rad), self.distance_mm - y * math.sin(self.tilt_rad))
        seen = self.normal_step + gamma / (2 * self.step_rad)
        step = seen
        for _ in range(_INVERSIONS):
            step = step + seen - self._seen(step)
        return step

    def x_mm(self, sample: ArrayLike, step: ArrayLike) -> Floats:
        """Where a sample lies along the slit, at a step; broadcasts."""
        gamma = self.gamma_rad(step)
        magnified = math.cos(self.tilt_rad) / np.cos(gamma + self.tilt_rad)
        return (np.asarray(sample, np.float64) - self.principal_sample) * self.sample_pitch_mm * magnified

    def sample_of(self, x_mm: ArrayLike, step: ArrayLike) -> Floats:
        """Sample, with fractions, that looks at a place, at a step: the inverse of `x_mm`."""
        pitch = self.x_mm(self.principal_sample + 1, step)
        return np.asarray(x_mm, np.float64) / pitch + self.principal_sample

    def line_pitch_mm(self, step: ArrayLike) -> Floats:
        """Distance of the places that neighbouring steps look at."""
        there = np.asarray(step, np.float64)
        return np.abs(self.y_mm(there + 0.5) - self.y_mm(there - 0.5))

    def linear_range(self) -> LinearRange:
        """Where lines may be taken for evenly spaced: within 22.5 degrees of the normal (Eq. 13)."""
        gamma = _LINEAR_GAMMA_RAD
        far = self.distance_mm * math.tan(gamma)
        return LinearRange(
            gamma_rad=gamma,
            steps=gamma / (2 * abs(self.step_rad)),
            y_mm=far,
            spacing_error_mm=far - self.distance_mm * gamma,
            defocus_mm=self.distance_mm * (1 / math.cos(gamma) - 1),
        )


@dataclass(frozen=True, slots=True)
class LinearRange:
    """How far from the normal a scan is nearly even, and what it costs there.

    Attributes:
        gamma_rad: Optical angle from the normal.
        steps: The same in motor steps.
        y_mm: The same in the object plane.
        spacing_error_mm: At the end of the range, from evenly spaced lines (Eq. 12).
        defocus_mm: At the end of the range, path longer than at the normal (Eq. 6).
    """

    gamma_rad: float
    steps: float
    y_mm: float
    spacing_error_mm: float
    defocus_mm: float


def number_grid(steps: ArrayLike, model: Geometry, pitch_mm: float) -> NDArray[np.int64]:
    """Number the lines of a grid that were seen at some steps, by a model that is roughly right.

    Returns:
        (line,) int64, 0 for the grid line nearest to the normal.

    Raises:
        CalibrationError: Two of them come out the same: the model's distance is too far off, or a line was seen twice.
    """
    y = model.y_mm(steps)
    offset = float(np.angle(np.mean(np.exp(2j * np.pi * y / pitch_mm)))) / (2 * np.pi) * pitch_mm
    numbers = np.rint((y - offset) / pitch_mm).astype(np.int64)
    if len(np.unique(numbers)) != len(numbers):
        raise CalibrationError(
            f"the grid lines cannot be told apart: at {model.distance_mm:g} mm they do not lie {pitch_mm:g} mm apart.",
            hint="give the distance to 5 %, and look whether a line was found twice",
        )
    return numbers


_SCALES: Final[dict[str, float]] = {
    "distance_mm": 100.0,
    "normal_step": 100.0,
    "tilt_rad": 0.1,
    "shaft_cos_steps": 1.0,
    "shaft_sin_steps": 1.0,
}
"""By how much each parameter may be off, roughly."""


def fit_geometry(
    steps: ArrayLike,
    y_mm: ArrayLike,
    start: Geometry,
    provenance: Provenance,
    *,
    fit_tilt: bool = False,
    origin_known: bool = True,
    turn: Turn = None,
) -> Geometry:
    """Fit distance, normal step and, if asked, tilt and a shaft out of true, to places that are known.

    A robust loss (soft L1 from 0.5 mm) keeps single lines that were found wrong from pulling the fit; points more than 60
    degrees from the normal are left out.

    Args:
        steps: At which the places were seen, with fractions, (point,).
        y_mm: Where they are, (point,); 0 is the foot of the normal.
        start: Where to begin, and what is not fitted.
        provenance: Where the points come from.
        fit_tilt: Also fit the tilt; needs points on both sides, far out.
        origin_known: The target's 0 is at the foot of the normal. If not, its place is fitted too and the normal step hangs on the
            curvature alone: expect an error some ten times as large.
        turn: Steps of a turn of a shaft out of true, whose error is fitted too; ``"find"`` looks for it, and fits none where the
            points show none.

    Raises:
        CalibrationError: Fewer than five points (seven with a shaft), points that are no numbers, or all in one place.
    """
    step, y = np.asarray(steps, np.float64), np.asarray(y_mm, np.float64)
    step, y = _usable(step, y, start)
    start = replace(start, turn_steps=math.nan, shaft_cos_steps=0.0, shaft_sin_steps=0.0, shaft_sigma_steps=math.nan)
    if turn == "find":
        rough = fit_geometry(step, y, start, provenance, fit_tilt=fit_tilt, origin_known=origin_known)
        pitch = rough.y_mm(step + 0.5) - rough.y_mm(step - 0.5)
        turn = find_turn(step, (y - rough.y_mm(step)) / pitch, slow=2 + fit_tilt)
    if turn is not None:
        start = replace(start, turn_steps=float(turn))
    if turn is not None and len(y) < _LEAST_POINTS + 2:
        raise CalibrationError(f"{len(y)} points are too few to fit a shaft out of true, too.", hint="a finer grid")
    names = ["distance_mm", "normal_step", *(["tilt_rad"] if fit_tilt else [])]
    names += ["shaft_cos_steps", "shaft_sin_steps"] if turn is not None else []
    begin = np.array([getattr(start, name) for name in names] + ([] if origin_known else [0.0]))

    def model(parameters: Floats) -> Geometry:
        return replace(start, **dict(zip(names, parameters.tolist(), strict=False)))

    def residuals(parameters: Floats) -> Floats:
        origin = 0.0 if origin_known else float(parameters[-1])
        return model(parameters).y_mm(step) + origin - y

    scale = np.array([_SCALES[name] for name in names] + ([] if origin_known else [10.0]))
    found = cast("Any", optimize.least_squares(residuals, begin, x_scale=scale, loss="soft_l1", f_scale=_OUTLIER_MM))
    best, jacobian = cast("tuple[Floats, Floats]", (found.x, found.jac))
    left = residuals(best)
    freedom = len(y) - len(begin)
    inside = np.abs(left) <= 3 * max(1.4826 * float(np.median(np.abs(left))), 1e-9)
    variance = float(np.sum(left[inside] ** 2)) / max(int(inside.sum()) - len(begin), 1) if freedom > 0 else math.nan
    sigma = np.sqrt(np.diag(np.linalg.pinv(jacobian.T @ jacobian)) * variance)
    error = dict(zip(names, sigma.tolist(), strict=False))
    return replace(
        model(best),
        distance_sigma_mm=error["distance_mm"],
        normal_sigma_steps=error["normal_step"],
        tilt_sigma_rad=error.get("tilt_rad", math.nan),
        shaft_sigma_steps=error.get("shaft_cos_steps", math.nan),
        residual_mm=math.sqrt(variance),
        points=len(y),
        provenance=provenance,
    )


def _usable(step: Floats, y: Floats, start: Geometry) -> tuple[Floats, Floats]:
    if step.ndim != 1 or step.shape != y.shape:
        raise CalibrationError(f"{step.shape} steps and {y.shape} places do not go together.")
    if not (np.isfinite(step).all() and np.isfinite(y).all()):
        raise CalibrationError("some points are no numbers.")
    near = np.abs(start.gamma_rad(step)) < _STEEPEST_RAD
    step, y = step[near], y[near]
    if len(y) < _LEAST_POINTS:
        raise CalibrationError(
            f"{len(y)} points within 60 degrees of the normal are too few; {_LEAST_POINTS} at least."
        )
    if np.ptp(step) == 0 or np.ptp(y) == 0:
        raise CalibrationError("all points lie in one place.")
    return step, y
