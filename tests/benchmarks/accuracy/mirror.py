"""Object plane, jitter, backlash, transfer functions and bars."""

from __future__ import annotations

import math
import tempfile
from pathlib import Path

import numpy as np
from rows import Row, acquire, region, rms

from scanhsi.calibration.geometry import Geometry
from scanhsi.calibration.result import Provenance
from scanhsi.calibration.usaf import columns
from scanhsi.characterise.bars_from_cube import bars_from_cube, find_bars

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
    seen = "21" if points == {21} else f"{min(points)} or {max(points)}"
    within = float(np.mean(np.abs(off) <= 0.5))
    return [
        Row(f"**object plane**, {seen} lines of a 6 mm grid, {name}, {seeds} instruments", "", ""),
        Row("distance 348.73 mm, rms error", "0.38 mm; within 0.5 mm", f"{rms(off):.3f} mm", rms(off) < 0.5),
        Row("largest, and share within 0.5 mm", "", f"{np.abs(off).max():.2f} mm, {100 * within:.0f} %"),
        Row(
            "error over the one given, rms",
            "about 1",
            f"{rms(np.array(off) / sigma):.2f}",
            rms(np.array(off) / sigma) < 1.6,
        ),
        Row("normal step, rms error", "0.20 steps", f"{rms(normal):.2f} steps"),
        Row("sample pitch, largest error", "", f"{100 * np.abs(pitch).max():.3f} %", np.abs(pitch).max() < 0.002),
    ]


def jitter(seeds: int) -> list[Row]:
    off, paper, raw = [], [], []
    for found, true in many(seeds, {}, lambda hsi: hsi.calibrate.jitter(exposure_s=EXPOSURE_S)):
        off.append(found.sigma_mm / true.jitter_mm - 1)
        paper.append(found.paper_mm / true.jitter_mm - 1)
        raw.append(found.raw_mm / true.jitter_mm)
    return [
        Row(
            f"**jitter** of 0.2 mm, slanted lines, a shaft out of true and not said which, {seeds} instruments", "", ""
        ),
        Row("rms error", "10 %", f"{100 * rms(off):.1f} %", rms(off) < 0.1),
        Row("largest", "10 %", f"{100 * np.abs(off).max():.1f} %", np.abs(off).max() < 0.1),
        Row("bias", "unbiased", f"{100 * np.mean(off):+.1f} %", abs(np.mean(off)) < 0.03),
        Row("the paper's clip, bias", "-3 %", f"{100 * np.mean(paper):+.1f} %"),
        Row("as it is, misalignment included", "1.59 of it", f"{np.mean(raw):.2f} of it"),
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
    return [
        Row(
            f"**backlash** of 0, 0.7, 2.4, 5.3 steps, with jitter of 0.88, 3 scans either way, {len(off)} instruments",
            "",
            "",
        ),
        Row("rms error", "0.1 steps", f"{rms(off):.3f} steps", rms(off) < 0.1),
        Row("largest", "0.1 steps", f"{np.abs(off).max():.3f} steps", np.abs(off).max() < 0.1),
        Row("error over the one given, rms", "about 1", f"{rms(pulls):.2f}", rms(pulls) < 1.8),
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
    count = 6 if axis == "line" else 1
    title = f"**slanted edge** along the {along}, jitter of {0.2283 * jitter_steps:.1f} mm, {count} scans, {seeds} instruments"
    mean = np.mean(off, axis=0)
    limit = 0.06 if axis == "line" and jitter_steps else 0.03
    return [
        Row(title.replace(" 1 scans", " 1 scan"), "", ""),
        Row(
            "MTF less the analytic curve, rms up to Nyquist",
            "against the curve",
            f"{rms(off):.3f}",
            rms(off) < limit / 2,
        ),
        Row("mean of the seeds, largest", "", f"{np.abs(mean).max():.3f}"),
        Row("frequency of half the contrast, rms error", "", f"{100 * rms(half):.1f} %", rms(half) < limit),
        Row("its bias", "", f"{100 * np.mean(half):+.1f} %"),
        Row("slant, rms error", "", f"{rms(angle):.2f} degrees"),
    ]


def bars(seeds: int) -> list[Row]:
    """Of a USAF target, found from its layout in each picture."""
    settings = {**FEW, **EVEN, "roi.samples": 800, "roi.sample_offset": 624}
    off, places, resolved = [], [], []
    for seed in range(1, seeds + 1):

        async def scanned(hsi):
            with tempfile.TemporaryDirectory() as folder:
                await hsi.camera.show("usaf")
                cube = Path(folder) / "usaf.zarr"
                await hsi.scan(hsi.default_plan(lines=300, step=1, start=-143, exposure_s=EXPOSURE_S), cube)
                found = find_bars(cube)
                return found, bars_from_cube(cube, "sample", found), bars_from_cube(cube, "line", found)

        turned = {"camera.target.turn_deg": 0.7 * seed - 2, "camera.seed": seed, "actuator.seed": seed}
        (found, slit, scan), true, config = acquire({**settings, **turned}, scanned)
        middle = true.principal_sample - region(config)[1].start
        turn = math.radians(true.target.turn_deg)
        for seen, drawn in zip(found, columns(), strict=True):
            x = math.cos(turn) * drawn.x_mm - math.sin(turn) * drawn.y_mm
            places.append((np.mean(seen.samples) - middle) * true.geometry.pixel_mm - x)
        wide = slit.bar_mm > 0.6
        half = 1 / (2 * slit.bar_mm)
        curve = np.exp(-2 * np.pi**2 * true.blur_mm**2 * half**2) * np.sinc(half * true.geometry.pixel_mm)
        off += (slit.contrast - curve)[wide].tolist()
        resolved.append((slit.resolved_mm, scan.resolved_mm))
    slits, scans = np.array(resolved).T
    return [
        Row(
            f"**USAF target**, turned by up to 2 degrees, its elements found by themselves, {seeds} instruments", "", ""
        ),
        Row("places along the slit, rms error", "", f"{rms(places):.3f} mm", rms(places) < 0.1),
        Row(
            "contrast along the slit, bars above 0.6 mm, rms error",
            "analytic",
            f"{rms(off):.3f}",
            rms(off) < 0.05,
        ),
        Row(
            "bar resolved along the slit (blur 0.08 mm, pixel 0.1 mm)",
            "",
            f"{slits.min():.2f} to {slits.max():.2f} mm",
        ),
        Row("along the scan (slit 0.55 mm, jitter 0.2 mm)", "", f"{scans.min():.2f} to {scans.max():.2f} mm"),
    ]


def equations() -> list[Row]:
    """What follows from the model alone, at the paper's distances."""
    step = 2 * np.pi / 19_200
    near, far = (Geometry(r, 0.0, step, 0.155, 599.5, Provenance()) for r in (225.0, 348.73))
    steps = np.linspace(-2000, 2000, 1001)
    turn = float(np.abs(near.y_mm(near.step_of(near.y_mm(steps))) - near.y_mm(steps)).max())
    reach, limits = far.linear_range(), near.linear_range()
    found = [
        ("pitch straight ahead, eqs. 8, 11", "0.2282 mm", float(far.line_pitch_mm(0.0)), 0.2282, 5e-5),
        ("linear range at 225 mm", "93.20 mm", limits.y_mm, 93.20, 5e-3),
        ("linear range at 348.73 mm", "144.45 mm", reach.y_mm, 144.45, 5e-3),
        ("spacing error there, eq. 12", "7.50 mm", reach.spacing_error_mm, 7.50, 5e-3),
        ("spacing error at 225 mm", "4.84 mm", limits.spacing_error_mm, 4.84, 5e-3),
        ("defocus there over the distance, eq. 6", "0.08239", reach.defocus_mm / far.distance_mm, 0.08239, 5e-6),
        ("half of the linear range", "600 steps", reach.steps, 600.0, 1e-6),
    ]
    rows = [Row("**equations** of the object plane", "", "")]
    rows += [Row(name, asked, f"{value:.5g}", abs(value - real) <= limit) for name, asked, value, real, limit in found]
    return [*rows, Row("step to place and back, largest", "1e-9 mm", f"{turn:.1e} mm", turn < 1e-9)]


def rows(seeds: int) -> list[Row]:
    found = distance(seeds, EVEN, "jitter of 0.2 mm")
    found += distance(seeds, {}, "jitter of 0.2 mm, shaft out of true by 0.35 mm")
    found += [*equations(), *jitter(seeds), *backlash(seeds), *bars(max(2, seeds // 4))]
    for axis in ("sample", "line"):
        for jitter_steps in (0.0, 0.876):
            found += transfer(seeds if jitter_steps else max(2, seeds // 4), axis, jitter_steps)
    return found
