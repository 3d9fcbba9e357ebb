"""A random scan: instrument, plan, storage and faults, all of it drawn from one seed and written as JSON."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from random import Random
from typing import Any, Final, Literal

from pydantic import BaseModel, ConfigDict, Field

from scanhsi.devices import PixelFormat
from scanhsi.engine import Mode, ScanPlan
from scanhsi.engine.plan import OnFault
from scanhsi.imager import default_plan
from scanhsi.instrument import InstrumentConfig, LightConfig
from scanhsi.testing.faults import ABOUT, NO_FAULTS, Fault, FaultPlan, Kind

_BASE: Final[dict[str, Any]] = {
    "name": "fuzz",
    "camera": {"driver": "simulated", "scene": "testpattern", "bench": "fuzz", "exposure_range_s": [0.0001, 2.0]},
    "actuator": {"driver": "simulated", "bench": "fuzz"},
    "geometry": {"distance": "0.35 m", "normal_step": 0},
    "storage": {"quicklook": False},
}

_DEFAULT_S: Final = 400.0
"""Virtual time that one fault may cost: homing, retries, deadlines of storage, one behind the other."""


class Case(BaseModel):
    """One scan of the fuzz.

    Attributes:
        seed: Of the delays of the simulated devices.
        bands, samples: Region that is read out.
        offset: (band, sample) of the region on the sensor, which is as much larger.
        overlap: Whether the camera exposes while it reads out.
        profile: Delays.
        plan: Of the scan, as in `ScanPlan`.
        lines_per_shard, codec, durability, bin_samples: How it is stored.
        target: Where to.
        resumes: Whether the lines that are left when it was interrupted are taken in another session.
        light: Whether there is one to be switched, and how long it warms up; None: there is not.
        faults: What goes wrong.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    seed: int = 0
    bands: int = Field(default=8, ge=1)
    samples: int = Field(default=8, ge=1)
    offset: tuple[int, int] = (0, 0)
    overlap: bool = True
    profile: str = "sensors2019"
    plan: dict[str, Any]
    lines_per_shard: int = 4
    codec: Literal["lz4", "zstd", "none", "raw"] = "none"
    durability: Literal["every shard", "at close"] = "every shard"
    bin_samples: int = 1
    target: Literal["memory", "disk", "nothing"] = "memory"
    light: float | None = Field(default=None, ge=0)
    resumes: bool = False
    faults: FaultPlan = NO_FAULTS

    def instrument(self) -> InstrumentConfig:
        """The instrument of this case."""
        base = _base()
        common: dict[str, Any] = {"seed": self.seed, "profile": self.profile}
        sensor = {"bands": self.bands + self.offset[0], "samples": self.samples + self.offset[1]}
        camera = base.camera.options.model_copy(update={**common, **sensor, "overlap": self.overlap})
        actuator = base.actuator.options.model_copy(update=common)
        roi = {"bands": self.bands, "samples": self.samples}
        place = {"band_offset": self.offset[0], "sample_offset": self.offset[1]}
        storage: dict[str, Any] = {
            "lines_per_shard": self.lines_per_shard,
            "codec": self.codec,
            "durability": self.durability,
            "bin_samples": self.bin_samples,
        }
        return base.model_copy(
            update={
                "light": None if self.light is None else _light(self.light),
                "camera": base.camera.model_copy(update={"options": camera}),
                "actuator": base.actuator.model_copy(update={"options": actuator}),
                "roi": _base_roi().model_copy(update={**roi, **place}),
                "storage": base.storage.model_copy(update=storage),
            }
        )

    def scan_plan(self) -> ScanPlan:
        """The plan of this case."""
        return default_plan(_base(), **self.plan)

    @property
    def deadline_s(self) -> float:
        """Virtual time within which the scan must have ended, whatever happens."""
        plan = self.scan_plan()
        lost_s = sum(
            _DEFAULT_S * min(fault.lasts, 10) + (fault.for_s or 0) * fault.lasts for fault in self.faults.faults
        )
        return 300 + plan.lines * (plan.exposure_s + 0.5) + lost_s

    def text(self) -> str:
        """As short JSON."""
        return self.model_dump_json(exclude_defaults=True)


@cache
def _base() -> InstrumentConfig:
    return InstrumentConfig.model_validate({**_BASE, "roi": {"bands": 8, "samples": 8}})


def _light(warm_up_s: float) -> LightConfig:
    return LightConfig.model_validate({"driver": "simulated", "bench": "fuzz", "warm_up_s": warm_up_s})


def _base_roi() -> Any:
    return _base().roi


@dataclass(frozen=True, slots=True)
class _Drawn:
    """How a kind of fault is drawn.

    Attributes:
        weight: How often.
        per_line: Opportunities a line.
        more: Opportunities beside those of the lines.
        lasts: Numbers of opportunities in a row.
    """

    weight: float = 1.0
    per_line: float = 1.0
    more: int = 0
    lasts: tuple[int, ...] = (1,)


_BURSTS: Final = (1, 1, 2, 5)
_DISK: Final = _Drawn(per_line=1.0, more=6, lasts=(1, 1, 3, 10**6))
_DRAWN: Final = {
    Kind.FRAME_LOST: _Drawn(2, lasts=_BURSTS),
    Kind.FRAME_INCOMPLETE: _Drawn(2, lasts=_BURSTS),
    Kind.FRAME_LATE: _Drawn(2),
    Kind.FRAME_TWICE: _Drawn(lasts=_BURSTS),
    Kind.FRAMES_SWAPPED: _Drawn(),
    Kind.FRAME_ID_WRAPS: _Drawn(),
    Kind.METADATA_STALE: _Drawn(),
    Kind.CAMERA_SILENT: _Drawn(),
    Kind.EXPOSURE_HANGS: _Drawn(),
    Kind.EXPOSURE_LONGER: _Drawn(lasts=_BURSTS),
    Kind.TEMPERATURE_DRIFTS: _Drawn(),
    Kind.SETTINGS_REFUSED: _Drawn(0.3, per_line=0, more=2),
    Kind.CONTROL_LOST: _Drawn(more=3),
    Kind.CAMERA_UNPLUGGED: _Drawn(more=3),
    Kind.MOVE_SLOW: _Drawn(lasts=_BURSTS),
    Kind.REPLY_LOST: _Drawn(),
    Kind.DONE_LOST: _Drawn(lasts=_BURSTS),
    Kind.STEPS_LOST: _Drawn(),
    Kind.MOTOR_STALLS: _Drawn(),
    Kind.LIMIT_HIT: _Drawn(),
    Kind.CONTROLLER_RESET: _Drawn(),
    Kind.HOME_WRONG: _Drawn(0.5, per_line=0, more=2),
    Kind.STOP_UNANSWERED: _Drawn(0.5, per_line=0, more=2),
    Kind.ACTUATOR_UNPLUGGED: _Drawn(more=2),
    Kind.WRITE_SLOW: _Drawn(2, more=6, lasts=(1, 4, 20)),
    Kind.DISK_FULL: _DISK,
    Kind.IO_ERROR: _DISK,
    Kind.PERMISSION_LOST: _DISK,
    Kind.NO_HANDLES: _DISK,
    Kind.KILLED: _Drawn(2, per_line=1.0, more=6),
    Kind.POWER_CUT: _Drawn(2, per_line=1.0, more=6),
    Kind.LOOP_STALLS: _Drawn(per_line=20, more=60),
    Kind.CLOCK_STEP: _Drawn(0.5, per_line=0, more=2),
    Kind.PAUSED: _Drawn(2, per_line=20, more=60),
    Kind.STOP_REQUESTED: _Drawn(2, per_line=20, more=60),
    Kind.CANCELLED: _Drawn(3, per_line=20, more=60),
}
_WAITS_S: Final = (0.0005, 0.003, 0.02, 0.1, 0.7, 6.0, 20.0, None)
_MOMENTS_S: Final = (0.0, 0.0, 0.001, 0.004, 0.02, 0.1)


def draw(seed: int | str, scan: int) -> Case:
    """The scan of that number, of that seed."""
    rng = Random(f"{seed}/{scan}")
    mode = rng.choice((Mode.SEQUENTIAL, Mode.STEPPED, Mode.STEPPED, Mode.STEPPED, Mode.CONTINUOUS))
    lines = rng.choice((rng.randint(1, 3), rng.randint(3, 12), rng.randint(8, 40)))
    step = rng.choice((1, 1, 2, -1, 7, -3))
    plan: dict[str, Any] = {
        "mode": mode.value,
        "lines": lines,
        "step": step,
        "start": rng.randint(-300, 300),
        "exposure_s": rng.choice((0.0002, 0.002, 0.01, 0.02, 0.05)),
        "pixel_format": rng.choice(tuple(kind.value for kind in PixelFormat if kind is not PixelFormat.MONO16)),
    }
    if mode is Mode.STEPPED and rng.random() < 0.35:
        plan["look_ahead"] = rng.choice((0.0, 0.01, 0.2, 0.5))
    if mode is not Mode.CONTINUOUS and rng.random() < 0.1:
        plan["step"] = 0
    if mode is Mode.CONTINUOUS:
        plan["exposure_s"] = max(plan["exposure_s"], 0.002)  # which the motor can follow
    plan |= _recovery(rng)
    durability = rng.choice(("every shard", "every shard", "at close"))
    case = Case(
        seed=rng.randrange(10**6),
        bands=rng.randint(2, 8) * 2,
        samples=rng.randint(2, 12) * 2,
        offset=(2 * rng.randint(0, 3), 2 * rng.randint(0, 3)) if rng.random() < 0.3 else (0, 0),
        overlap=rng.random() < 0.7,
        profile=rng.choice(("sensors2019", "sensors2019", "ideal")),
        plan=plan,
        lines_per_shard=rng.choice((1, 2, 4, 4, 8, 16)),
        codec=rng.choice(("none", "lz4", "raw", "raw", "zstd")),
        durability=durability,
        bin_samples=rng.choice((1, 1, 1, 2)),
        target=rng.choices(("memory", "disk", "nothing"), (95, 2, 3))[0],
        resumes=rng.random() < 0.5,
        faults=FaultPlan(faults=tuple(_fault(rng, lines) for _ in range(_how_many(rng))), seed=rng.randrange(1000)),
    )
    return _lit(case, rng) if rng.random() < 0.3 else case


def _lit(case: Case, rng: Random) -> Case:
    """The same under a light, which may fail, too."""
    faults = case.faults
    if rng.random() < 0.3:
        fault = Fault(
            kind=Kind.LIGHT_UNANSWERED, nth=rng.randrange(3), lasts=rng.choice((1, 2, 9)), for_s=rng.choice(_WAITS_S)
        )
        faults = faults.model_copy(update={"faults": (*faults.faults, fault)})
    return case.model_copy(update={"light": rng.choice((0.0, 0.0, 3.0)), "faults": faults})


def _recovery(rng: Random) -> dict[str, Any]:
    """What the plan says about faults."""
    plan: dict[str, Any] = {"on_fault": rng.choice((OnFault.RETRY, OnFault.RETRY, OnFault.SKIP, OnFault.ABORT)).value}
    if rng.random() < 0.3:
        plan |= {"line_retries": rng.choice((0, 1, 5)), "retries": rng.choice((0, 2, 100))}
    if rng.random() < 0.2:
        plan["recover_within_s"] = rng.choice((1.0, 10.0))
    return plan


def _how_many(rng: Random) -> int:
    return rng.choices((0, 1, 2, 3, 5), (10, 45, 25, 15, 5))[0]


def _fault(rng: Random, lines: int) -> Fault:
    kind = rng.choices(tuple(_DRAWN), [drawn.weight for drawn in _DRAWN.values()])[0]
    drawn, takes = _DRAWN[kind], ABOUT[kind].takes
    given: dict[str, Any] = {}
    if "for_s" in takes:
        given["for_s"] = rng.choice(_WAITS_S)
        if kind in (Kind.EXPOSURE_LONGER, Kind.WRITE_SLOW, Kind.LOOP_STALLS, Kind.PAUSED) and given["for_s"] is None:
            given["for_s"] = 0.3
    if "after_s" in takes:
        given["after_s"] = rng.choice(_MOMENTS_S)
    if "by" in takes:
        given["by"] = {Kind.CLOCK_STEP: -3600.0, Kind.TEMPERATURE_DRIFTS: 200.0}.get(kind, rng.choice((-5, 1, 3)))
    nth = rng.randrange(max(1, round(drawn.per_line * lines) + drawn.more))
    return Fault(kind=kind, nth=nth, lasts=rng.choice(drawn.lasts), **given)
