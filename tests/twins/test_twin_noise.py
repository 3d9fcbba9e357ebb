"""Long scans through the real drivers over bad cables: 1 % of the serial bytes garbled, 1 per mille of the packets lost.

Not part of ``make test``. With 20,000 lines, as the numbers in the documentation are meant::

    SCANHSI_SOAK_LINES=20000 python -m scanhsi_sim.twins.netns python -m pytest -m soak tests/twins/test_twin_noise.py -s
"""

from __future__ import annotations

import os
import shutil
import sys
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import scanhsi
from scanhsi import clock
from scanhsi.cube import LineStatus
from scanhsi.engine import Progress
from scanhsi.instrument import load_instrument
from scanhsi_sim.scenes.testpattern import TestPattern
from scanhsi_sim.twins.rig import TwinRig

pytestmark = [pytest.mark.twin, pytest.mark.soak, pytest.mark.timeout(6 * 3600)]

LINES = int(os.environ.get("SCANHSI_SOAK_LINES", "600"))
SENSOR = (1088, 2048)
GARBLED = 100
"""Of 10,000 bytes, each way."""
LOST = 1000
"""Of a million packets."""
ROOM_KB = 32 * SENSOR[0] * SENSOR[1] // 1024
"""Memory may come and go by so much; a leak of one frame for each fault would be more than that."""
_CHECKED_AT_ONCE = 8


@dataclass
class Observed:
    """Memory and open files of this process as the scan goes on: (lines taken, kB, files)."""

    lines: int
    samples: list[tuple[int, int, int]] = field(default_factory=list[tuple[int, int, int]])

    def __call__(self, progress: Progress) -> None:
        self.samples.append((progress.taken, _resident_kb(), len(os.listdir("/proc/self/fd"))))

    def settled(self) -> np.ndarray[Any, np.dtype[np.float64]]:
        """Without the first third, in which buffers are touched for the first time."""
        samples = np.array(self.samples, np.float64)
        return samples[samples[:, 0] >= self.lines / 3]

    def lows(self) -> np.ndarray[Any, np.dtype[np.float64]]:
        """Lines, kB and files in ten parts of what is settled: a low one of each, for buffers come and go with each fault."""
        settled = self.settled()
        parts = np.array_split(settled, min(10, len(settled)))
        return np.array([np.percentile(part, [50, 20, 20], axis=0).diagonal() for part in parts])

    @property
    def kb_per_1000_lines(self) -> float:
        lows = self.lows()
        return 1000 * float(np.polyfit(lows[:, 0], lows[:, 1], 1)[0])


def _resident_kb() -> int:
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmRSS"):
            return int(line.split()[1])
    raise AssertionError("no VmRSS")


@pytest.fixture
def output(tmp_path: Path) -> Iterator[Path]:
    yield tmp_path / "cube.zarr"
    shutil.rmtree(tmp_path / "cube.zarr", ignore_errors=True)  # pytest would keep it for three runs


@pytest.mark.parametrize(
    ("on_fault", "attempts", "lines"), [("retry", 2, min(LINES, 600)), ("retry", 30, LINES), ("skip", 30, LINES)]
)
def test_a_long_scan_over_bad_cables(on_fault: str, attempts: int, lines: int, output: Path) -> None:
    """No stored line is wrong, each exposure is a line, a missing line or a line retaken, and nothing grows.

    A driver that asks into silence only twice gives up one request in some hundreds: the port is opened anew then, the mirror
    homed, which takes so long that fewer lines must do.
    """
    observed = Observed(lines)

    async def main() -> tuple[scanhsi.ScanReport, dict[str, int], dict[str, Any]]:
        async with TwinRig() as rig:
            config = load_instrument(
                "twin",
                {
                    "actuator.port": rig.port,
                    "camera.address": rig.camera_address,
                    "storage.lines_per_shard": 16,
                    "actuator.minimum_step": -lines,
                    "actuator.maximum_step": lines,
                    "actuator.reply_timeout_s": 0.05,
                    "actuator.reply_attempts": attempts,
                },
            )
            await rig.stepper.command(f"noise {GARBLED} 0")
            await rig.camera.command(f"loss {LOST}")
            async with scanhsi.open_instrument(config) as hsi:
                plan = hsi.default_plan(
                    lines=lines,
                    step=1,
                    exposure="10 ms",
                    pixel_format="Mono8",
                    on_fault=on_fault,
                    line_retries=250,
                    retries=100 * lines,
                )
                report = await hsi.scan(plan, output, on_progress=observed)
            await rig.stepper.command("noise 0 0")
            return report, await rig.stepper.stats(), await rig.camera.stats()

    began = time.monotonic()
    report, serial, camera = clock.run(main())
    took_s = time.monotonic() - began
    checked = check_lines(output, report)
    reasons = check_accounts(report, camera, output)
    size_mb = sum(file.stat().st_size for file in output.rglob("*") if file.is_file()) / 1e6
    settled, lows = observed.settled(), observed.lows()
    _, grown_kb, grown_files = lows[-1] - lows[0]
    sys.stdout.write(
        f"\n{on_fault}, {attempts} attempts: {lines} lines, {checked} of them checked and right, {report.missing} missing,"
        f" {report.retaken} taken again, {len(report.incidents)} incidents; {camera['exposures']} exposures, {serial['garbled']} of"
        f" {serial['rx_bytes'] + serial['tx_bytes']} bytes garbled; {took_s:.0f} s, {report.interrupted_s:.0f} s of it"
        f" interrupted, {report.lines_per_second:.1f} lines/s between, regret {report.regret or float('nan'):.2f}; memory"
        f" {settled[:, 1].min() / 1024:.0f} to {settled[:, 1].max() / 1024:.0f} MB, {grown_kb:+.0f} kB from first to last,"
        f" {observed.kb_per_1000_lines:+.0f} kB/1000 lines; files {settled[:, 2].min():.0f} to {settled[:, 2].max():.0f};"
        f" cube {size_mb:.0f} MB; lost: {dict(reasons)}"
    )
    assert serial["garbled"] > lines / 10
    assert grown_kb < ROOM_KB
    assert grown_files <= 4, "open files grow"


def check_lines(path: Path, report: scanhsi.ScanReport) -> int:
    """Compare every stored line with what the mirror showed at its step; the number of them."""
    cube = scanhsi.open_cube(path)
    scene, status, steps = TestPattern(SENSOR), cube["status"].values, cube["mirror_step"].values
    assert report.stored == np.count_nonzero(status == LineStatus.STORED)
    assert set(np.flatnonzero(status == LineStatus.MISSING).tolist()) == set(report.missing_reasons)
    lines = report.stored + report.missing
    assert lines == len(status)
    checked = 0
    for first in range(0, lines, _CHECKED_AT_ONCE):
        block = cube["cube"].isel(line=slice(first, first + _CHECKED_AT_ONCE)).values
        for line in range(first, first + block.shape[1]):
            if status[line] != LineStatus.STORED:
                continue
            assert steps[line] == line - lines // 2
            truth = scene.render(
                steps[line], steps[line], exposure_s=0, gain_db=0, shape=SENSOR, offset=(0, 0), bits=8, index=0
            )
            assert np.array_equal(block[:, line - first], truth), f"line {line} is wrong"
            checked += 1
    assert checked == report.stored
    return checked


def check_accounts(report: scanhsi.ScanReport, camera: dict[str, Any], path: Path) -> Counter[str]:
    """Each exposure of the camera is a stored line, a missing one with its reason, or a try that the cube tells of; the reasons."""
    attempt = scanhsi.open_cube(path)["attempt"].values.astype(int)
    assert camera["smeared"] == 0, "the mirror moved in an exposure"
    assert camera["busy"] == camera["unread"] == 0
    assert report.retaken == np.count_nonzero(attempt > 1)
    reasons = Counter(reason.split(" (tried")[0] for reason in report.missing_reasons.values())
    if not report.incidents:
        assert camera["exposures"] == len(attempt) == attempt.sum()
        return reasons
    assert report.missing == 0
    assert camera["exposures"] <= attempt.sum(), "an exposure that no try tells of"
    # of a line, and of the next one that was under way
    assert camera["exposures"] - len(attempt) <= 2 * len(report.incidents)
    return reasons + Counter(incident.cause.rsplit(": ", 1)[-1].split(" (")[0] for incident in report.incidents)
