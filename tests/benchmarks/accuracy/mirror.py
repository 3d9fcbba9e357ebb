"""Object plane, jitter, backlash, transfer functions and bars."""

from __future__ import annotations

import math

import numpy as np
from rows import Row, acquire, rms

FEW = {"roi.samples": 600, "roi.bands": 8, "roi.sample_offset": 724, "roi.band_offset": 480}
EXPOSURE_S = 0.04
EVEN = {"actuator.mirror.misalignment_steps": 0.0}


def many(seeds: int, settings: dict[str, object], protocol):
    for seed in range(1, seeds + 1):
        yield acquire({**FEW, "camera.seed": seed, "actuator.seed": seed, **settings}, protocol)[:2]


def distance(seeds: int, settings: dict[str, object], name: str) -> list[Row]:
    off, sigma, normal, pitch, points = [], [], [], [], set()
    for found, true in many(seeds, settings, lambda hsi: hsi.calibrate.geometry(exposure_s=EXPOSURE_S)):
        off.append(found.distance_mm - true.geometry.distance_mm)
        sigma.append(found.distance_sigma_mm)
        normal.append(found.normal_step - true.geometry.normal_step)
        pitch.append(found.sample_pitch_mm / true.geometry.pixel_mm - 1)
        points.add(found.points)
    name = f"grid, {min(points)} lines, {name}, {seeds} seeds: "
    within = float(np.mean(np.abs(off) <= 0.5))
    return [
        Row(f"{name}distance 348.73 mm, rms error", "0.38 mm; within 0.5 mm", f"{rms(off):.3f} mm", rms(off) < 0.5),
        Row(f"{name}largest, and share within 0.5 mm", "", f"{np.abs(off).max():.2f} mm, {100 * within:.0f} %"),
        Row(
            f"{name}error over the one given, rms",
            "about 1",
            f"{rms(np.array(off) / sigma):.2f}",
            rms(np.array(off) / sigma) < 1.6,
        ),
        Row(f"{name}normal step, rms error", "0.20 steps", f"{rms(normal):.2f} steps"),
        Row(
            f"{name}sample pitch, largest error", "", f"{100 * np.abs(pitch).max():.3f} %", np.abs(pitch).max() < 0.002
        ),
    ]


def jitter(seeds: int) -> list[Row]:
    off, paper, raw = [], [], []
    for found, true in many(seeds, {}, lambda hsi: hsi.calibrate.jitter(exposure_s=EXPOSURE_S, turn=320)):
        off.append(found.sigma_mm / true.jitter_mm - 1)
        paper.append(found.paper_mm / true.jitter_mm - 1)
        raw.append(found.raw_mm / true.jitter_mm)
    name = f"jitter of 0.2 mm, slanted lines, shaft out of true, {seeds} seeds: "
    return [
        Row(f"{name}rms error", "10 %", f"{100 * rms(off):.1f} %", rms(off) < 0.1),
        Row(f"{name}largest", "10 %", f"{100 * np.abs(off).max():.1f} %", np.abs(off).max() < 0.1),
        Row(f"{name}bias", "unbiased", f"{100 * np.mean(off):+.1f} %", abs(np.mean(off)) < 0.03),
        Row(f"{name}the paper's clip, bias", "-3 %", f"{100 * np.mean(paper):+.1f} %"),
        Row(f"{name}as it is, misalignment included", "1.59 of it", f"{np.mean(raw):.2f} of it"),
    ]


def backlash(seeds: int) -> list[Row]:
    off, pulls = [], []
    for steps in (0.0, 0.7, 2.4, 5.3):
        settings = {"actuator.mirror.backlash_steps": steps}
        for found, true in many(
            max(1, seeds // 4), settings, lambda hsi: hsi.calibrate.backlash(exposure_s=EXPOSURE_S)
        ):
            off.append(found.lag_steps - true.mirror.backlash_steps)
            pulls.append(off[-1] / found.lag_sigma_steps)
    name = f"backlash of 0, 0.7, 2.4, 5.3 steps, with jitter of 0.88, {len(off)} instruments: "
    return [
        Row(f"{name}rms error", "0.1 steps", f"{rms(off):.3f} steps", rms(off) < 0.1),
        Row(f"{name}largest", "0.1 steps", f"{np.abs(off).max():.3f} steps", np.abs(off).max() < 0.1),
        Row(f"{name}error over the one given, rms", "about 1", f"{rms(pulls):.2f}", rms(pulls) < 1.8),
    ]


def analytic(true, axis: str, frequency):
    """Transfer of lens, pixel, slit and jitter across an edge whose normal is turned from the axis by the edge's slant."""
    turn = math.radians(true.target.edge_deg)
    along, across = (true.slit_mm, true.geometry.pixel_mm) if axis == "line" else (true.geometry.pixel_mm, true.slit_mm)
    shaken = true.jitter_mm * (math.cos(turn) if axis == "line" else math.sin(turn))
    blur = np.exp(-2 * np.pi**2 * (true.blur_mm**2 + shaken**2) * frequency**2)
    return blur * np.abs(np.sinc(frequency * along * math.cos(turn)) * np.sinc(frequency * across * math.sin(turn)))


def transfer(seeds: int, axis: str, jitter_steps: float) -> list[Row]:
    off, half, angle = [], [], []
    settings = {**EVEN, "actuator.mirror.periodic_steps": 0.0, "actuator.mirror.jitter_steps": jitter_steps}

    async def protocol(hsi):
        return await hsi.calibrate.resolution(axis=axis, exposure_s=EXPOSURE_S)

    for found, true in many(seeds, settings, protocol):
        curve = analytic(true, axis, found.frequency_per_mm)
        off.append(found.mtf - curve)
        half.append(found.mtf50_per_mm / float(np.interp(-0.5, -curve, found.frequency_per_mm)) - 1)
        angle.append(abs(found.angle_deg) - true.target.edge_deg)
    along = "slit" if axis == "sample" else "scan"
    name = f"slanted edge along the {along}, jitter of {0.2283 * jitter_steps:.1f} mm, {seeds} seeds: "
    mean = np.mean(off, axis=0)
    limit = 0.06 if axis == "line" and jitter_steps else 0.03
    return [
        Row(
            f"{name}MTF less the analytic curve, rms up to Nyquist",
            "against the curve",
            f"{rms(off):.3f}",
            rms(off) < limit / 2,
        ),
        Row(f"{name}mean of the seeds, largest", "", f"{np.abs(mean).max():.3f}"),
        Row(f"{name}frequency of half the contrast, rms error", "", f"{100 * rms(half):.1f} %", rms(half) < limit),
        Row(f"{name}its bias", "", f"{100 * np.mean(half):+.1f} %"),
        Row(f"{name}slant, rms error", "", f"{rms(angle):.2f} degrees"),
    ]


def rows(seeds: int) -> list[Row]:
    found = distance(seeds, EVEN, "jitter of 0.2 mm")
    found += distance(seeds, {}, "jitter of 0.2 mm, shaft out of true by 0.35 mm")
    found += [*jitter(seeds), *backlash(seeds)]
    for axis in ("sample", "line"):
        for jitter_steps in (0.0, 0.876):
            found += transfer(seeds if jitter_steps else max(2, seeds // 4), axis, jitter_steps)
    return found
