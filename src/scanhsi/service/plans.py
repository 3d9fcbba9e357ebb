"""Plan aids: what a plan will cost and show, before anything moves. Pure functions."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

import numpy as np

from scanhsi.engine import Course, ScanPlan
from scanhsi.instrument import InstrumentConfig
from scanhsi.instrument.timing import timing_of
from scanhsi.service.jobs import plain
from scanhsi.timing.prediction import predict


def plan_facts(config: InstrumentConfig, plan: ScanPlan, course: Course) -> dict[str, Any]:
    """What a plan comes to: time, size, field, pixels, smear. Plain JSON types.

    Args:
        config: Of the instrument.
        plan: Checked against the instrument.
        course: What it comes to there.
    """
    return plain(
        {
            "plan": plan.model_dump(mode="json"),
            "first_step": int(course.steps[0]),
            "last_step": int(course.steps[-1]),
            "size_bytes": _size_bytes(config, course),
            "time": _time(config, plan),
            "field": _field(config, course),
        }
    )


def _size_bytes(config: InstrumentConfig, course: Course) -> int:
    """Of the pixels, before they are compressed."""
    roi, storage = course.settings.roi, config.storage
    assert roi is not None, "Imager.course fills the ROI in"
    bands, samples = -(-roi.bands // storage.bin_bands), -(-roi.samples // storage.bin_samples)
    return course.lines * bands * samples * np.dtype(course.settings.pixel_format.dtype).itemsize


def _time(config: InstrumentConfig, plan: ScanPlan) -> dict[str, Any] | None:
    """From the delays of the instrument; None where they are not known."""
    timing = timing_of(config)
    if plan.pixel_format not in timing.formats or not plan.step:
        return None
    found = predict(
        timing,
        plan.mode,
        plan.pixel_format,
        exposure_s=plan.exposure_s,
        lines=plan.lines,
        step=plan.step,
        period_s=plan.period_s,
    )
    return {**asdict(found), "marks": list(timing.marks)}


def _field(config: InstrumentConfig, course: Course) -> dict[str, Any]:
    """In the object plane: y = -r tan(2 angle), Eqs. 5 and 12."""
    geometry, roi = config.geometry, course.settings.roi
    assert roi is not None, "Imager.course fills the ROI in"
    distance_mm = 1000 * geometry.distance_m
    view = 2 * course.angles_rad
    inside = np.abs(view) < math.radians(89)
    y_mm = np.where(inside, -distance_mm * np.tan(np.where(inside, view, 0.0)), np.nan)
    one_mm = 2 * distance_mm * geometry.step_angle_rad
    pitch_mm = None if geometry.sample_pitch_m is None else 1000 * geometry.sample_pitch_m
    edge = float(np.abs(view).max())
    return {
        "height_mm": abs(float(y_mm[-1] - y_mm[0])),
        "y_mm": [float(y_mm[0]), float(y_mm[-1])],
        "width_mm": None if pitch_mm is None else roi.samples * pitch_mm,
        "line_pitch_mm": one_mm * abs(course.stride),
        "sample_pitch_mm": pitch_mm,
        "aspect": None if pitch_mm is None else one_mm * abs(course.stride) / pitch_mm,
        "square_step": None if pitch_mm is None else max(1, round(pitch_mm / one_mm)),
        "edge_stretch": 1 / math.cos(edge) ** 2 if edge < math.pi / 2 else math.inf,
        "defocus_mm": distance_mm * (1 / math.cos(edge) - 1) if edge < math.pi / 2 else math.inf,
        "linear": edge <= math.pi / 8,
    }
