"""The same engine through the real drivers: GigE Vision over a socket, the firmware behind a serial port, every pixel checked."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

import scanhsi
from support.exact import wrong_lines
from support.twin_scans import scan_twin

pytestmark = [pytest.mark.twin, pytest.mark.timeout(180)]

LINES = 150


@pytest.mark.parametrize("pixel_format", ["Mono8", "Mono12Packed"])
def test_stepped_scan_is_exact(
    pixel_format: str, tmp_path: Path, record_property: Callable[[str, object], None]
) -> None:
    report, stats, position = scan_twin(
        {"lines": LINES, "mode": "stepped", "step": 2, "exposure": "10 ms", "pixel_format": pixel_format},
        tmp_path / "cube.zarr",
    )
    record_property("report", json.dumps(report.to_json()))
    assert (report.stored, report.missing) == (LINES, 0), report.missing_reasons
    assert wrong_lines(tmp_path / "cube.zarr") == []
    assert scanhsi.open_cube(tmp_path / "cube.zarr")["cube"].shape == (1088, LINES, 2048)
    assert stats["position"] % 19200 == position % 19200


@pytest.mark.parametrize("pixel_format", ["Mono8", "Mono12Packed"])
def test_continuous_scan_by_position_triggers_is_exact(pixel_format: str, tmp_path: Path) -> None:
    report, stats, _ = scan_twin(
        {
            "lines": LINES,
            "mode": "continuous",
            "step": 2,
            "exposure": "10 ms",
            "period": "40 ms",
            "pixel_format": pixel_format,
        },
        tmp_path / "cube.zarr",
    )
    assert report.stored + report.missing == LINES
    assert report.missing == 0, report.missing_reasons
    assert wrong_lines(tmp_path / "cube.zarr") == []
    assert stats["triggers"] == LINES
