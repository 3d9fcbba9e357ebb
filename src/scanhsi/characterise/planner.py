"""Plans a field of view: steps and lines from millimetres, square pixels, depth of field against the curvature of the scan."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from scanhsi.devices.errors import ConfigError
from scanhsi.instrument import InstrumentConfig

_LINEAR_RAD: Final = math.pi / 8  # Eq. 13


@dataclass(frozen=True, slots=True)
class FieldPlan:
    """A scan of a field.

    Attributes:
        lines, step: Of the plan to scan it.
        start: Step of the first line.
        line_pitch_mm: Distance of lines at the normal; farther out they lie wider apart.
        edge_pitch_mm: The same at the end of the scan.
        sample_pitch_mm: Distance of samples at the normal.
        aspect: Line pitch over sample pitch; 1 is a square pixel.
        height_mm: Length of the scan.
        width_mm: Of the slit's view.
        view_rad: Optical angle from the normal at the end of the scan.
        linear: Whether it stays within the linear range of 22.5 degrees (Eq. 13).
        defocus_mm: Path at the end of the scan longer than at the normal (Eq. 6).
        depth_of_field_mm: Range of distances that are sharp; nan where the lens is not known.
        sharp: Whether all of the scan is, focused halfway between; None where the lens is not known.
    """

    lines: int
    step: int
    start: int
    line_pitch_mm: float
    edge_pitch_mm: float
    sample_pitch_mm: float
    aspect: float
    height_mm: float
    width_mm: float
    view_rad: float
    linear: bool
    defocus_mm: float
    depth_of_field_mm: float
    sharp: bool | None


def plan_field_of(
    config: InstrumentConfig,
    height_mm: float,
    *,
    step: int | None = None,
    f_number: float | None = None,
    focal_mm: float | None = None,
) -> FieldPlan:
    """Plan the scan of a field with an instrument; see `plan_field`.

    Raises:
        ConfigError: Its file does not say how large a pixel is, or the field cannot be.
    """
    geometry = config.geometry
    if geometry.sample_pitch_m is None or config.roi is None:
        raise ConfigError(f"{config.name} does not say the size of a sample: geometry.sample_pitch, and roi.")
    return plan_field(
        height_mm,
        distance_mm=1000 * geometry.distance_m,
        sample_pitch_mm=1000 * geometry.sample_pitch_m,
        samples=config.roi.samples,
        step_rad=geometry.step_angle_rad,
        normal_step=geometry.normal_step,
        step=step,
        f_number=f_number,
        focal_mm=focal_mm,
    )


def plan_field(
    height_mm: float,
    *,
    distance_mm: float,
    sample_pitch_mm: float,
    samples: int,
    step_rad: float,
    normal_step: float = 0.0,
    step: int | None = None,
    f_number: float | None = None,
    focal_mm: float | None = None,
    pixel_um: float = 5.5,
    blur_px: float = 2.0,
) -> FieldPlan:
    """Plan the scan of a field around the normal.

    Args:
        height_mm: Length of the field along the scan.
        distance_mm: Mirror to object plane.
        sample_pitch_mm: Distance of samples at the normal.
        samples: Of the region.
        step_rad: Turn of the mirror a step.
        normal_step: Step that looks straight.
        step: Steps from line to line; None chooses those that make pixels most nearly square.
        f_number: Of the lens, for the depth of field.
        focal_mm: Of the lens.
        pixel_um: Size of a pixel of the sensor.
        blur_px: Blur that still counts as sharp, in pixels.

    Raises:
        ConfigError: Something that cannot be.
    """
    if min(height_mm, distance_mm, sample_pitch_mm, samples, abs(step_rad)) <= 0 or (step is not None and step < 1):
        raise ConfigError("a field needs a height, a distance, a sample pitch, samples and steps above 0.")
    one = 2 * distance_mm * abs(step_rad)  # Eq. 5 at the normal
    stride = step or max(1, round(sample_pitch_mm / one))
    view = math.atan(height_mm / 2 / distance_mm)
    half = math.ceil(view / (2 * abs(step_rad)) / stride)
    lines = 2 * half + 1
    reach = 2 * abs(step_rad) * stride * half
    if reach >= math.radians(60):
        raise ConfigError(f"{height_mm:g} mm at {distance_mm:g} mm need a view of {math.degrees(reach):.0f} degrees.")
    defocus = distance_mm * (1 / math.cos(reach) - 1)
    depth = _depth_of_field(distance_mm, f_number, focal_mm, pixel_um, blur_px)
    return FieldPlan(
        lines=lines,
        step=stride,
        start=round(normal_step) - half * stride,
        line_pitch_mm=one * stride,
        edge_pitch_mm=one * stride / math.cos(reach) ** 2,
        sample_pitch_mm=sample_pitch_mm,
        aspect=one * stride / sample_pitch_mm,
        height_mm=2 * distance_mm * math.tan(reach),
        width_mm=samples * sample_pitch_mm,
        view_rad=reach,
        linear=reach <= _LINEAR_RAD,
        defocus_mm=defocus,
        depth_of_field_mm=depth,
        sharp=None if math.isnan(depth) else defocus <= depth,
    )


def _depth_of_field(
    distance_mm: float, f_number: float | None, focal_mm: float | None, pixel_um: float, blur_px: float
) -> float:
    """Thin lens: between the distances at which a point is a disc of the allowed blur."""
    if f_number is None or focal_mm is None:
        return math.nan
    if f_number <= 0 or not 0 < focal_mm < distance_mm:
        raise ConfigError(f"a lens of {focal_mm:g} mm at f/{f_number:g} does not image {distance_mm:g} mm.")
    blur = f_number * blur_px * pixel_um * 1e-3 * (distance_mm - focal_mm)
    near = distance_mm * focal_mm**2 / (focal_mm**2 + blur)
    far = focal_mm**2 - blur
    return math.inf if far <= 0 else distance_mm * focal_mm**2 / far - near
