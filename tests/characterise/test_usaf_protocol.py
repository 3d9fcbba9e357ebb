"""Bars of the simulated USAF target, against what jitter and blur leave of a square wave's first harmonic."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import scanhsi
from scanhsi.calibration.resolution import BarContrast
from scanhsi.characterise.bars_from_cube import Bars, bars_from_cube, find_bars, load_bars
from scanhsi.clock import run_virtual
from scanhsi.instrument import load_instrument
from scanhsi_sim.scenes.usaf import usaf_elements

LINES, SAMPLES, START = 180, 800, -83  # around the true normal step, 7.3
DISTANCE, PITCH, NORMAL = 348.73, 0.1, 7.3


def elements() -> list[Bars]:
    """Where the elements lie, by the truth."""
    found: list[Bars] = []
    step_mm = 2 * DISTANCE * 2 * math.pi / 19_200
    for one in usaf_elements():
        for axis, (x, y) in (("sample", one.upright), ("line", one.lying)):
            line = NORMAL - y / step_mm - START
            sample = x / PITCH + SAMPLES / 2 - 0.5
            along, across = 2.5 * one.bar_mm, 1.2 * one.bar_mm  # their ends are blurred
            half_y, half_x = (along, across) if axis == "line" else (across, along)
            lines = round(line - half_y / step_mm), round(line + half_y / step_mm)
            samples = round(sample - half_x / PITCH), round(sample + half_x / PITCH)
            found.append(Bars(axis, one.bar_mm, lines, samples))
    return found


def by_size(bars: Bars) -> tuple[str, float]:
    return bars.axis, -bars.bar_mm


def test_bars_are_resolved_down_to_what_the_optics_leave(tmp_path: Path) -> None:
    config = load_instrument(
        "characterise",
        {
            "roi.samples": SAMPLES,
            "roi.sample_offset": 624,
            "roi.bands": 6,
            "roi.band_offset": 500,
            "camera.scene": "usaf",
            "actuator.mirror.misalignment_steps": 0.0,
        },
    )

    async def main() -> None:
        async with scanhsi.open_instrument(config) as hsi:
            plan = hsi.default_plan(lines=LINES, step=1, start=START)
            await hsi.scan(plan, tmp_path / "usaf.zarr", target="usaf")

    run_virtual(main())
    table = tmp_path / "bars.csv"
    rows = [f"{b.axis},{b.bar_mm},{b.lines[0]},{b.lines[1]},{b.samples[0]},{b.samples[1]}" for b in elements()]
    table.write_text("axis,bar_mm,first_line,last_line,first_sample,last_sample\n" + "\n".join(rows))
    found: dict[str, BarContrast] = {}
    for axis in ("line", "sample"):
        found[axis] = bars_from_cube(tmp_path / "usaf.zarr", axis, load_bars(table))
    located = find_bars(tmp_path / "usaf.zarr")
    for truly, seen in zip(sorted(elements(), key=by_size), sorted(located, key=by_size), strict=True):
        assert seen.axis == truly.axis
        assert seen.bar_mm == pytest.approx(truly.bar_mm)
        np.testing.assert_allclose(seen.samples, truly.samples, atol=2)  # 0.2 mm
        inside = np.array([0 < line < LINES - 1 for line in seen.lines])
        np.testing.assert_allclose(
            np.array(seen.lines)[inside], np.array(truly.lines)[inside], atol=2
        )  # 0.4 mm: jitter is 0.2
    itself = bars_from_cube(tmp_path / "usaf.zarr", "sample", located)
    np.testing.assert_allclose(itself.contrast[itself.bar_mm > 0.6], 1.0, atol=0.12)
    assert itself.resolved_mm < 0.3
    frequency = 1 / (2 * found["sample"].bar_mm)
    expected = np.exp(-2 * np.pi**2 * 0.08**2 * frequency**2) * np.sinc(0.1 * frequency)
    wide = found["sample"].bar_mm > 0.6  # jitter along the scan takes lines out of shorter bars
    np.testing.assert_allclose(found["sample"].contrast[wide], expected[wide], atol=0.07)
    assert found["sample"].resolved_mm < 0.3
    assert 0.3 < found["line"].resolved_mm < 1.0  # jitter of 0.2 mm and a slit of 0.55 mm
    assert found["line"].provenance.simulated is True
