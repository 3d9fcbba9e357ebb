"""Look-ahead through the real drivers: what it gains on the twins, and that whatever it smears is flagged.

The truth is the emulated mirror's own history and the camera twin, which counts the exposures in which that mirror moved.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

import scanhsi
from scanhsi import clock
from scanhsi.cube.records import LineRecords
from scanhsi.cube.sink import DiscardSink
from scanhsi.engine import ScanReport, run_scan
from scanhsi.instrument import load_instrument
from scanhsi_sim.twins.rig import TwinRig

pytestmark = [pytest.mark.twin, pytest.mark.timeout(180)]

LINES = 90


class KeepingSink(DiscardSink):
    """Discards lines and keeps their records."""

    async def open(self, records: LineRecords) -> None:
        self.records = records
        await super().open(records)


@dataclass
class Scanned:
    """A scan of the twins, and what truly happened.

    Attributes:
        report, records: Of the engine.
        smeared: Exposures in which the mirror moved, counted by the camera twin.
        begun_ns: When the mirror truly began to move to each line but the first, (lines - 1,).
    """

    report: ScanReport
    records: LineRecords
    smeared: int
    begun_ns: NDArray[np.int64]

    @property
    def latency_ms(self) -> NDArray[np.float64]:
        """From the command to the true begin."""
        return (self.begun_ns - self.records.stamps["commanded"][1:]) * 1e-6


def scan_twins(asked: list[tuple[str, float | None]], lines: int = LINES, **options: object) -> list[Scanned]:
    """Scans with (exposure, look_ahead), one after the other on the same twins; one that a busy computer lost packets of, again."""

    async def main() -> list[Scanned]:
        scanned: list[Scanned] = []
        async with TwinRig(scene="dark") as rig:
            written = {"actuator.port": rig.port, "camera.address": rig.camera_address, **options}
            async with scanhsi.open_instrument(load_instrument("twin", written)) as hsi:
                for exposure, look_ahead in asked:
                    plan = hsi.default_plan(
                        lines=lines, step=2, exposure=exposure, pixel_format="Mono8", look_ahead=look_ahead
                    )
                    scan = await scan_once(rig, hsi, plan)
                    for _ in range(2):
                        if scan.report.missing:
                            scan = await scan_once(rig, hsi, plan)
                    scanned.append(scan)
        return scanned

    return clock.run(main())


async def scan_once(rig: TwinRig, hsi: scanhsi.Imager, plan: scanhsi.ScanPlan) -> Scanned:
    before = (await rig.camera.stats())["smeared"]
    sink = KeepingSink()
    report = await run_scan(hsi.course(plan), hsi.camera, hsi.actuator, sink)
    smeared = (await rig.camera.stats())["smeared"] - before
    with rig.stepper.open_mirror() as mirror:
        changes = mirror._history()[:, 0]
    commanded = sink.records.stamps["commanded"][1:]
    return Scanned(report, sink.records, smeared, changes[np.searchsorted(changes, commanded)])


def gained_ms(plain: Scanned, ahead: Scanned) -> float:
    """Of the median line period: single stalls of a busy computer count little."""
    periods = [np.median(np.diff(each.records.stamps["exposure_start"])) for each in (plain, ahead)]
    return float(periods[0] - periods[1]) * 1e-6


@pytest.mark.parametrize("exposure", ["20 ms", "100 ms"])
def test_look_ahead_gains_the_time_on_the_wire_and_smears_nothing_unflagged(
    exposure: str, record_property: Callable[[str, object], None]
) -> None:
    """Motion never begins before the driver tells, so every line that the mirror moved in is flagged.

    Not every flag is a smear: the driver takes the begin of a motion 0.5 ms and more too early, the end of an exposure up to its
    margin too late. One thing only an emulator can do: when its process was kept waiting it runs faster for a while, and bytes
    need less than their time on the wire. Such lines are told apart by that, and have to be few.
    """
    lines = LINES if exposure == "20 ms" else LINES // 3
    plain, sure, accepting = scan_twins([(exposure, None), (exposure, 0.0), (exposure, 0.05)], lines)
    for scanned in (plain, sure, accepting):
        stamps, report = scanned.records.stamps, scanned.report
        record_property("scan", f"{report.look_ahead}: {report.period_s * 1e3:.2f} ms, {report.smeared} flagged")
        record_property("latency_ms", np.percentile(scanned.latency_ms, [0, 5, 50, 95]).round(2).tolist())
        assert report.missing == 0
        hurried = scanned.begun_ns < stamps["started"][1:]
        assert hurried.mean() < 0.1
        truth = scanned.begun_ns < stamps["exposure_end"][:-1]
        flagged = scanned.records.smeared[:-1].astype(bool)
        assert not np.any(truth & ~flagged & ~hurried)
        assert scanned.smeared <= int((flagged | hurried).sum())
        assert report.smeared == int(flagged.sum())
    assert (plain.report.smeared, sure.report.smeared) == (0, 0)
    for ahead in (sure, accepting):
        leads_ms = (ahead.records.stamps["exposure_end"][:-1] - ahead.records.stamps["commanded"][1:]) * 1e-6
        record_property("gained_ms", [round(gained_ms(plain, ahead), 2), round(float(np.median(leads_ms)), 2)])
        assert np.median(leads_ms) > 0.5  # 1.5 ms less the lateness of this computer's timers
    assert np.all((plain.records.stamps["commanded"][1:] - plain.records.stamps["exposure_end"][:-1]) >= 0)
