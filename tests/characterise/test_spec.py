"""The specification sheet: what is in it, in which order, and what is not."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from scanhsi.calibration.conditions import Conditions
from scanhsi.calibration.geometry import Geometry
from scanhsi.calibration.jitter import jitter
from scanhsi.calibration.repeatability import repeatability
from scanhsi.calibration.resolution import BarContrast
from scanhsi.calibration.result import Provenance, Result, identity
from scanhsi.calibration.wavelength import Wavelength
from scanhsi.characterise.spec import TABLE_7, specification
from scanhsi.characterise.spec_row import Timing
from scanhsi.characterise.spec_write import draw_pages, to_markdown, write_sheet
from scanhsi.devices.errors import ConfigError
from scanhsi.instrument import load_instrument

Floats = NDArray[np.float64]

MEASURED = Provenance(
    conditions=Conditions(0.02, 0.0, "Mono12", {"samples": 1200}), simulated=False, taken="2026-01-02"
)
PLANE = Geometry(
    distance_mm=348.73,
    normal_step=0.0,
    step_rad=2 * np.pi / 19_200,
    sample_pitch_mm=0.1,
    principal_sample=599.5,
    provenance=MEASURED,
    distance_sigma_mm=0.38,
    normal_sigma_steps=0.2,
    points=21,
)


def bars(axis: str, resolved_mm: float) -> BarContrast:
    return BarContrast(axis, np.array([1.0, 0.5]), np.array([0.8, 0.3]), resolved_mm, 0.2, MEASURED)


def shaken() -> Result:
    residual = np.random.default_rng(1).standard_normal(400)
    return jitter(np.linspace(0, 1, 400), 0.2 * residual / residual.std(), MEASURED, harmonics=0)


def test_without_results_every_row_says_so() -> None:
    sheet = specification([])
    assert [row.key for row in sheet.table] == list(TABLE_7)
    assert {row.value for row in sheet.table} == {"not measured"}
    assert not sheet.further
    assert "SIMULATED" not in to_markdown(sheet)


def test_rows_have_value_uncertainty_and_source() -> None:
    timing = Timing("sequential", "Mono8", 0.1, 0.75, 0.002, 49, "bench/observations.jsonl", "2026-01-01", False)
    sheet = specification(
        [("geometry.nc", PLANE), ("jitter.nc", shaken())],
        instrument=load_instrument("sensors2019"),
        timings=[timing],
    )
    rows = {row.key: row for row in (*sheet.table, *sheet.further)}
    assert (rows["distance"].value, rows["distance"].uncertainty) == ("348.73 mm", "0.38 mm")
    assert rows["rotation"].value.startswith("0.3927 rad (22.5 deg, 1200 steps)")
    assert rows["resolution"].value == "1200 x 1201 pixels"
    assert rows["microstepping"].number == pytest.approx(0.74, rel=0.01)  # 0.2 mm, 10 %
    assert (rows["efficiency"].value, rows["efficiency"].source) == ("75.0 %", "bench/observations.jsonl")
    assert rows["gain"].source == "instrument file sensors2019, not measured"
    assert rows["snr"].value == "not measured"
    assert sheet.simulated is False


def scale(fwhm_nm: float, first_nm: float) -> Wavelength:
    lines: Floats = np.array([500.0, 700.0])
    width: Floats = np.full(2, fwhm_nm)
    return Wavelength(
        1088,
        np.array([first_nm, 0.53]),
        np.eye(2) * 1e-6,
        lines,
        lines,
        lines,
        width,
        width,
        0.01,
        0.5,
        2,
        "",
        MEASURED,
    )


def test_a_tile_gives_the_range_only_where_no_lamp_does() -> None:
    lamp, tile = ("lamp.nc", scale(2.9, 371.0)), ("tile.nc", scale(np.nan, 372.0))
    both = {row.key: row for row in specification([lamp, tile]).table}
    assert both["wavelength range"].source == "lamp.nc"
    assert both["spectral resolution"].value.startswith("2.90 nm")
    alone = {row.key: row for row in specification([tile]).table}
    assert alone["wavelength range"].value == "372.0-948.1 nm"
    assert alone["spectral resolution"].value == "not measured"


def test_the_drive_of_the_mirror_has_rows_with_errors_in_the_order_of_kinds() -> None:
    rng = np.random.default_rng(1)
    again = repeatability(rng.normal(0, 0.9, (5, 11)), rng.normal(2.4, 0.9, (5, 11)), np.arange(11.0), 0.2282, MEASURED)
    sheet = specification([("again.nc", again), ("jitter.nc", shaken()), ("geometry.nc", PLANE)])
    keys = [row.key for row in sheet.further]
    assert keys == [
        "distance",
        "normal step",
        "jitter",
        "repeatability",
        "repeatability one way",
        "approach",
        "reversal",
    ]
    rows = {row.key: row for row in sheet.further}
    assert rows["reversal"].uncertainty.endswith("steps")
    assert rows["approach"].identity == identity(again)
    assert f"again.nc {identity(again)}, 2026-01-02" in to_markdown(sheet)


def test_the_youngest_result_counts() -> None:
    older = replace(PLANE, distance_mm=300.0, provenance=replace(MEASURED, taken="2025-12-31"))
    sheet = specification([("new.nc", PLANE), ("old.nc", older)])
    assert next(row for row in sheet.further if row.key == "distance").source == "new.nc"


def test_the_bar_resolved_is_the_worse_of_both_axes() -> None:
    sheet = specification([("scan.nc", bars("line", 0.5)), ("slit.nc", bars("sample", 0.35))])
    row = next(row for row in sheet.table if row.key == "usaf")
    assert row.number == 0.5
    assert row.source == "scan.nc"


def test_one_simulated_row_makes_the_sheet_loud(tmp_path: Path) -> None:
    simulated = replace(PLANE, provenance=replace(MEASURED, simulated=True))
    sheet = specification([("jitter.nc", shaken()), ("geometry.nc", simulated)])
    assert sheet.simulated
    assert "> **SIMULATED" in to_markdown(sheet)
    write_sheet(sheet, tmp_path / "spec.json")
    assert json.loads((tmp_path / "spec.json").read_text())["simulated"] is True
    with pytest.raises(ConfigError, match=r"\.md, \.json or \.pdf"):
        write_sheet(sheet, tmp_path / "spec.docx")


def test_a_long_sheet_goes_on_on_a_further_pages() -> None:
    timings = [Timing("stepped", f"Format{n}", 0.1, 0.9, 0.01, 9, "bench.jsonl", "", True) for n in range(60)]
    assert len(draw_pages(specification([], timings=timings))) > 1
