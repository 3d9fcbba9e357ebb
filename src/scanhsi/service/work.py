"""The work of jobs: each calls the Python interface as a script would."""

from __future__ import annotations

from collections.abc import AsyncGenerator, Sequence
from contextlib import asynccontextmanager
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from typing import Any, Final

import numpy as np
from pydantic import ValidationError

from scanhsi.calibration.result import Result
from scanhsi.characterise.aids import auto_exposure
from scanhsi.characterise.spec_rows import result_rows
from scanhsi.characterise.station import Target
from scanhsi.clock import RealTime
from scanhsi.cube.reader import cube_summary
from scanhsi.cube.records import NOT_STAMPED, LineRecords
from scanhsi.devices import PixelFormat
from scanhsi.devices.errors import ConfigError, CubeError
from scanhsi.devices.frames import Pixels
from scanhsi.engine import Course, Mode, Progress, ScanControl, ScanPlan, ScanReport
from scanhsi.service.calibrations import Calibration
from scanhsi.service.jobs import Job, plain
from scanhsi.service.station import Station
from scanhsi.timing.observed import deliveries
from scanhsi.timing.spans import shares, stage_spans

_BUDGET_LINES: Final = 40


def plan_for(station: Station, given: dict[str, Any]) -> ScanPlan:
    """A plan of what is given, the settings of the camera and the instrument file, in this order.

    Raises:
        ConfigError: A field is wrong.
    """
    settings = station.settings
    chosen: dict[str, Any] = {
        "exposure_s": settings.exposure_s,
        "gain_db": settings.gain_db,
        "pixel_format": settings.pixel_format,
        **given,
    }
    return station.imager.default_plan(**chosen)


def scan_job(
    station: Station,
    plan: ScanPlan,
    output: str | None,
    *,
    discard: bool = False,
    target: str | None = None,
    real_time: str | None = None,
) -> Job:
    """Start a scan.

    Raises:
        OutOfRange, UnsupportedFeature, CubeExists, ConfigError: Refused; nothing moved.
        DeviceBusy: A job is under way.
    """
    imager = station.imager
    course = imager.course(plan)
    try:
        options = RealTime() if real_time is None else RealTime.of(real_time)
    except ValueError as error:
        raise ConfigError("the real-time options are wrong:", [str(error)]) from error
    path = None if discard else station.folder.new(output or f"{datetime.now():%Y%m%d-%H%M%S}.zarr", ".zarr")
    title = f"{plan.mode} scan of {plan.lines} lines" + ("" if path is None else f" into {path.name}")
    job = Job("scan", title, None if path is None else path.name, control=ScanControl())
    job.request = {"plan": plan.model_dump(mode="json"), "target": target}

    async def work(job: Job) -> dict[str, Any]:
        async with _watching(station, job, plan, course) as watching:
            report = await imager.scan(
                plan,
                path,
                on_progress=watching.progress,
                control=job.control,
                real_time=options,
                target=target,
                watch=watching.watch,
            )
        return _told(report)

    return station.begin(job, work)


def continued_job(station: Station, cube: str) -> Job:
    """Finish a scan that was interrupted; see `scanhsi.Imager.resume`.

    Raises:
        NoSuch, CubeError: There is nothing to be resumed.
        DeviceBusy: A job is under way.
    """
    path = station.folder.cube(cube)
    try:
        plan = ScanPlan.model_validate(cube_summary(path).attributes.get("plan"))
    except ValidationError as error:
        raise CubeError(f"{cube} does not tell its plan: it cannot be gone on with.") from error
    course = station.imager.course(plan)
    job = Job("scan", f"the rest of {cube}", cube, control=ScanControl())
    job.request = {"plan": plan.model_dump(mode="json"), "resume": cube}

    async def work(job: Job) -> dict[str, Any]:
        async with _watching(station, job, plan, course) as watching:
            report = await station.imager.resume(
                path, on_progress=watching.progress, control=job.control, watch=watching.watch
            )
        return _told(report)

    return station.begin(job, work)


def _told(report: ScanReport) -> dict[str, Any]:
    """The report; the cube goes by its name in the data folder."""
    return {**report.to_json(), "output": None if report.output is None else Path(report.output).name}


@asynccontextmanager
async def _watching(station: Station, job: Job, plan: ScanPlan, course: Course) -> AsyncGenerator[_Watching]:
    """Show a scan to the viewers."""
    spectral, roi = station.imager.config.spectral, course.settings.roi
    assert roi is not None, "Imager.course fills the ROI in"
    station.preview.begin(
        job.id,
        shape=roi.shape,
        bits=plan.pixel_format.bits,
        exposure_s=plan.exposure_s,
        lines=plan.lines,
        wavelength_nm=spectral.wavelengths_nm(roi.bands, roi.band_offset) if spectral else None,
    )
    try:
        yield _Watching(station, job)
    finally:
        await station.preview.finish()


class _Watching:
    """Tells of a scan while it runs."""

    def __init__(self, station: Station, job: Job) -> None:
        self._station = station
        self._job = job
        self._records: LineRecords | None = None

    def watch(self, line: int, pixels: Pixels, records: LineRecords) -> None:
        """See a line pass."""
        self._records = records
        self._station.preview.watch(line, pixels, records)

    def progress(self, progress: Progress) -> None:
        """A few times a second."""
        job = self._job
        job.progress = {**plain(progress), **(self._budget(progress.taken + progress.missing) or {})}
        self._station.events.publish("progress", {"job": job.id, **job.progress})

    def _budget(self, reached: int) -> dict[str, Any] | None:
        """Where the time of the last lines went (figure 5): by stage, alone and hidden behind others."""
        if self._records is None or reached < 4:
            return None
        window = slice(max(0, reached - _BUDGET_LINES), reached)
        stamps = {stage: column[window] for stage, column in self._records.stamps.items()}
        exposed = np.flatnonzero(stamps["exposure_start"] != NOT_STAMPED)
        if len(exposed) < 4 or len(deliveries(stamps)) < 2:
            return None
        shown = int(exposed[-2])
        origin = int(stamps["exposure_start"][shown])
        spans = stage_spans(stamps)
        timeline: dict[str, list[float]] = {}
        for stage, span in spans.items():
            for place in np.flatnonzero(span.line == shown):
                timeline[stage] = [(int(edge[place]) - origin) * 1e-9 for edge in (span.begin, span.end)]
        return {
            "budget": {stage: asdict(share) for stage, share in shares(stamps).items()},
            "timeline": timeline,
            "period_s": float(np.diff(deliveries(stamps)).mean()) * 1e-9,
            "line": window.start + shown,
        }


def auto_exposure_job(station: Station, target: float) -> Job:
    """Find the exposure of the white tile, and set it.

    Raises:
        DeviceBusy: A job is under way.
    """

    async def work(job: Job) -> dict[str, Any]:
        found = await auto_exposure(station.imager, target=target)
        await station.set_camera(exposure_s=found.exposure_s)
        return plain(found)

    return station.begin(Job("auto-exposure", f"auto-exposure to {100 * target:g} % of full scale"), work)


def benchmark_job(
    station: Station, *, exposures_s: Sequence[float], modes: Sequence[Mode], formats: Sequence[PixelFormat], lines: int
) -> Job:
    """Measure line periods: short scans that store nothing.

    Raises:
        OutOfRange, UnsupportedFeature: One of them is not possible here; nothing moved.
        DeviceBusy: A job is under way.
    """
    imager = station.imager
    plans = [
        imager.default_plan(mode=mode, pixel_format=format, exposure_s=exposure_s, lines=lines)
        for format in formats
        for mode in modes
        for exposure_s in exposures_s
    ]
    for plan in plans:
        imager.course(plan)
    job = Job("benchmark", f"benchmark: {len(plans)} scans of {lines} lines")

    async def work(job: Job) -> dict[str, Any]:
        rows: list[dict[str, Any]] = []
        for number, plan in enumerate(plans):
            said = f"{number + 1} of {len(plans)}: {plan.mode}, {plan.pixel_format}, {1000 * plan.exposure_s:g} ms"
            station.jobs.tell(job, said)
            report = await imager.scan(plan, None)
            rows.append({"pixel_format": str(plan.pixel_format), **{name: getattr(report, name) for name in _MEASURED}})
        return {"simulated": imager.instrument.simulated, "lines": lines, "rows": rows}

    return station.begin(job, work)


_MEASURED: Final = ("mode", "exposure_s", "period_s", "lines_per_second", "efficiency", "bound_s", "regret", "missing")


def calibration_job(
    station: Station, kind: Calibration, output: str | None, options: dict[str, Any], asked: dict[str, Any]
) -> Job:
    """Start a calibration. A person is asked for targets, unless the camera is simulated and knows them.

    Raises:
        DeviceBusy: A job is under way.
        CubeExists, ConfigError: The name of the result.
    """
    path = station.folder.new(output or f"{kind}-{datetime.now():%Y%m%d-%H%M%S}.nc", ".nc")
    job = Job("calibration", f"calibration: {kind.replace('_', ' ')}", path.name)
    job.request = asked

    async def work(job: Job) -> dict[str, Any]:
        async def prompt(target: Target) -> None:
            await station.jobs.ask(job, target.request)

        calibrate = station.imager.calibrate.asking(prompt, lambda text: station.jobs.tell(job, text))
        result: Result = await getattr(calibrate, kind)(path, **options)
        return {"kind": result.kind, "simulated": result.provenance.simulated, "rows": rows_of(result, path)}

    return station.begin(job, work)


def rows_of(result: Result, path: Path) -> list[dict[str, Any]]:
    """What a result says, as rows of the specification sheet."""
    return [plain(row) for row in result_rows(result, path.name)]
