"""What a line costs: sweep exposure, pixel format, scenario and mode on one instrument, and write down every line."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import Any
from uuid import uuid4

from scanhsi.bench.observations import OBSERVATIONS, Journal, Observation, Session, observation
from scanhsi.bench.provenance import provenance
from scanhsi.bench.scenarios import Scenario, staged
from scanhsi.clock import RealTime, is_virtual, real_time, run_blocking
from scanhsi.cube.reader import read_records
from scanhsi.cube.records import LineRecords
from scanhsi.cube.sink import DiscardSink
from scanhsi.devices import PixelFormat, Sweeps
from scanhsi.devices.errors import CubeError
from scanhsi.engine import Mode, ScanPlan, run_scan
from scanhsi.imager import Imager, open_instrument
from scanhsi.instrument import InstrumentConfig

EXPOSURES_S = (0.010, 0.015, 0.020, 0.030, 0.050, 0.070, 0.100, 0.150, 0.200, 0.300, 0.500)
FORMATS = (PixelFormat.MONO8, PixelFormat.MONO12_PACKED, PixelFormat.MONO12)

Tell = Callable[[int, int, Observation], None]


@dataclass(frozen=True, slots=True)
class LineSweep:
    """What to measure. None stands for all of the usual ones that the instrument can do.

    Attributes:
        lines: Lines of each scan.
        exposures_s: Exposure times.
        formats: Pixel formats.
        modes: Scan modes.
        scenarios: How much of a line is done. Continuous scans know only the full one: without a motion there is no sweep.
        step: Motor steps from line to line.
        seed: Of simulated devices. Each exposure draws from a seed of its own, so that exposures are independent; modes, formats
            and scenarios share it, so that their differences are not chance.
        options: Against lateness, for the time of the sweep; what was granted is in the facts of the session.
    """

    lines: int = 50
    exposures_s: Sequence[float] | None = None
    formats: Sequence[PixelFormat] | None = None
    modes: Sequence[Mode] | None = None
    scenarios: Sequence[Scenario] = tuple(Scenario)
    step: int = 1
    seed: int = 1
    options: RealTime = field(default_factory=RealTime)


@dataclass(frozen=True, slots=True)
class _Point:
    plan: ScanPlan
    scenario: Scenario
    seed: int | None


async def measure_lines(
    config: InstrumentConfig, sweep: LineSweep, folder: Path, *, command: str, tell: Tell | None = None
) -> Session:
    """Measure, and append every scan to ``observations.jsonl`` in ``folder``.

    In virtual time lines are discarded after they were copied, for storing has no modelled cost of its own; in real time the
    full and the static scenario write a cube, which is deleted again.

    Args:
        config: The instrument.
        sweep: What to measure.
        folder: Created where it does not exist.
        command: How this was asked for, for the record.
        tell: Called after each scan with its number, how many there are, and what was seen.

    Raises:
        ConfigError, DeviceError, CubeError, ScanFailed: As a scan; what was measured before is in the file.
    """
    with real_time(sweep.options) as granted:
        return await _measure(config, sweep, folder, {"command": command, "real_time": asdict(granted)}, tell)


async def _measure(
    config: InstrumentConfig, sweep: LineSweep, folder: Path, asked: dict[str, Any], tell: Tell | None
) -> Session:
    async with open_instrument(config) as imager:
        points = _points(imager, sweep)
        facts = {
            **asked,
            "virtual_time": is_virtual(),
            "simulated": imager.instrument.simulated,
            "devices": imager.instrument.describe(),
            "instrument": config.model_dump(mode="json"),
            **provenance(),
        }
    name = uuid4().hex[:12]
    journal, scratch = _journal(folder, name), folder / f".{name}.zarr"
    journal.begin(facts)
    session = Session(facts, [])
    for seed, together in groupby(points, key=lambda point: point.seed):
        async with open_instrument(config, seed=seed) as imager:
            for point in together:
                records = await _scan(staged(imager, point.scenario), point, scratch)
                session.observations.append(_seen(records, point))
                journal.add(session.observations[-1])
                if tell is not None:
                    tell(len(session.observations), len(points), session.observations[-1])
    return session


def _journal(folder: Path, session: str) -> Journal:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CubeError(f"cannot create {folder}: {error.strerror or error}.") from error
    return Journal(folder / OBSERVATIONS, session)


def _points(imager: Imager, sweep: LineSweep) -> list[_Point]:
    """Everything that will be measured, checked before the first scan."""
    info = imager.instrument.camera_info
    seeded = all(
        "seed" in type(device.options).model_fields for device in (imager.config.camera, imager.config.actuator)
    )
    exposures_s = sweep.exposures_s or [exposure for exposure in EXPOSURES_S if exposure in info.exposure]
    formats = sweep.formats or [kind for kind in FORMATS if kind in info.pixel_formats]
    modes = sweep.modes or [mode for mode in Mode if mode is not Mode.CONTINUOUS or isinstance(imager.actuator, Sweeps)]
    points = [
        _Point(plan, scenario, sweep.seed + number if seeded else None)
        for number, exposure_s in enumerate(exposures_s)
        for pixel_format in formats
        for mode in modes
        for scenario in (sweep.scenarios if mode is not Mode.CONTINUOUS else (Scenario.FULL,))
        for plan in [
            imager.default_plan(
                lines=sweep.lines,
                exposure_s=exposure_s,
                pixel_format=pixel_format,
                mode=mode,
                step=sweep.step,
                start=None,
            )
        ]
    ]
    for point in points:
        imager.course(point.plan)
    return points


async def _scan(imager: Imager, point: _Point, scratch: Path) -> LineRecords:
    """The records of one scan: of a cube where lines are really stored, else of lines let go."""
    if is_virtual() or point.scenario is Scenario.ACQUIRE:
        sink = Watched()
        await run_scan(imager.course(point.plan), imager.camera, imager.actuator, sink)
        return sink.records
    try:
        await imager.scan(point.plan, scratch)
        return read_records(scratch)
    finally:
        await run_blocking(0.0, partial(shutil.rmtree, scratch, ignore_errors=True))


def _seen(records: LineRecords, point: _Point) -> Observation:
    return observation(
        records,
        mode=point.plan.mode,
        scenario=point.scenario,
        pixel_format=point.plan.pixel_format,
        exposure_s=point.plan.exposure_s,
        seed=point.seed,
    )


class Watched(DiscardSink):
    """Lets lines go and keeps what is known of them."""

    def __init__(self) -> None:
        super().__init__()
        self.records = LineRecords(0)

    async def open(self, records: LineRecords) -> None:
        """Keep the records."""
        self.records = records
        await super().open(records)
