"""What to scan: the plan a person writes, and what it comes to on a given instrument."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum, unique

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from scanhsi.devices import CameraSettings, PixelFormat
from scanhsi.instrument.quantities import Decibels, Seconds, Steps, Written


@unique
class Mode(StrEnum):
    """How exposure, transfer and motion follow each other."""

    SEQUENTIAL = "sequential"
    """Everything in turn, as in the paper: expose, receive, store, move. The baseline."""
    STEPPED = "stepped"
    """The mirror moves the moment an exposure ends, while that frame is still in transfer. No line is ever dropped, and none
    smeared unless look-ahead accepts it."""
    CONTINUOUS = "continuous"
    """The mirror sweeps at constant speed. Fastest; a line is smeared by the part of its pitch that passes while it is exposed."""


@unique
class OnFault(StrEnum):
    """What a scan does about a fault on its way."""

    ABORT = "abort"
    """The first fault ends the scan, a lost frame too."""
    SKIP = "skip"
    """A lost frame costs its line, which is marked missing; a lost device ends the scan. Nothing is done twice."""
    RETRY = "retry"
    """A lost frame is taken again at its place (step modes), a lost device is opened anew, and the scan goes on with the first line
    that it has not received."""


@dataclass(frozen=True, slots=True)
class Recovery:
    """What a scan does about faults, and for how long.

    Attributes:
        on_fault: What to do.
        line_retries: How often one line may be tried again. Then a lost frame costs the line, a lost device the scan.
        retries: How often lines may be tried again in all.
        within_s: Time in which a lost device must be back.
    """

    on_fault: OnFault = OnFault.SKIP
    line_retries: int = 3
    retries: int = 100
    within_s: float = 60.0


class ScanPlan(Written):
    """A scan, as a person describes it: ``ScanPlan(lines=300, exposure="20 ms", mode="stepped")``.

    What is not given is taken from the instrument file by `scanhsi.Imager.plan`, else from the defaults here.
    """

    lines: int = Field(gt=0, le=1_000_000, description="Number of lines, one mirror position each.")
    exposure_s: Seconds = Field(alias="exposure", gt=0, description="Exposure time of a line.")
    gain_db: Decibels = Field(default=0.0, alias="gain", ge=0, description="Camera gain.")
    pixel_format: PixelFormat = Field(
        default=PixelFormat.MONO12_PACKED, description="Pixel format on the link; 12-bit formats are stored as uint16."
    )
    mode: Mode = Field(default=Mode.STEPPED, description="sequential, stepped or continuous.")
    step: Steps = Field(
        default=1,
        description="Motor steps from one line to the next; negative scans downwards, 0 takes all lines at one place.",
    )
    start: Steps | None = Field(
        default=None,
        description="Step of the first line; left out, the scan is centred on the normal of the object plane.",
    )
    period_s: Seconds | None = Field(
        default=None,
        alias="period",
        gt=0,
        description="Line period of a continuous scan; left out, the shortest safe one.",
    )
    look_ahead: float | None = Field(
        default=None,
        ge=0,
        le=0.5,
        description="Stepped scans: send each move early, so that it begins as the exposure ends; the accepted probability that "
        "a line's begins before, which smears and flags the line. 0 goes only as far as is sure.",
    )
    on_fault: OnFault = Field(
        default=OnFault.SKIP,
        description="skip: a lost frame costs its line, a lost device ends the scan; retry: lost frames are taken again, lost "
        "devices opened anew; abort: the first fault ends the scan.",
    )
    line_retries: int = Field(default=3, ge=0, le=250, description="How often one line may be tried again.")
    retries: int = Field(default=100, ge=0, description="How often lines may be tried again in all.")
    recover_within_s: Seconds = Field(
        default=60.0, alias="recover_within", gt=0, description="Time in which a lost device must be back."
    )

    def model_post_init(self, context: object, /) -> None:
        """Refuse combinations that cannot mean anything."""
        del context
        if self.step == 0 and self.mode is Mode.CONTINUOUS:
            raise ValueError("step must not be 0 in mode continuous: the mirror has to sweep")
        if self.period_s is not None and self.mode is not Mode.CONTINUOUS:
            raise ValueError(f"period is for continuous scans only; mode {self.mode} finds its own")
        if self.look_ahead is not None and self.mode is not Mode.STEPPED:
            raise ValueError(f"look_ahead is for stepped scans only, not for mode {self.mode}")

    @property
    def recovery(self) -> Recovery:
        """What the scan does about faults."""
        return Recovery(self.on_fault, self.line_retries, self.retries, self.recover_within_s)

    def steps(self, normal_step: int) -> NDArray[np.int64]:
        """Mirror step of each line, int64 (lines,)."""
        first = self.start if self.start is not None else normal_step - self.step * (self.lines // 2)
        return first + self.step * np.arange(self.lines, dtype=np.int64)


@dataclass(frozen=True, slots=True)
class Course:
    """A plan on a given instrument: everything the modes need to know, nothing left open.

    Attributes:
        mode: How the lines are taken.
        settings: Of the camera.
        steps: Mirror step of each line, int64 (lines,).
        angles_rad: Mirror angle of each line from the normal, float64 (lines,).
        period_s: Asked line period of a continuous scan; None for the shortest safe one.
        look_ahead: Of a stepped scan: accepted probability that a line is smeared by a move sent early; None sends none early.
        recovery: What to do about faults.
    """

    mode: Mode
    settings: CameraSettings
    steps: NDArray[np.int64]
    angles_rad: NDArray[np.float64]
    period_s: float | None = None
    look_ahead: float | None = None
    recovery: Recovery = Recovery()

    @property
    def lines(self) -> int:
        """Number of lines."""
        return len(self.steps)

    @property
    def stride(self) -> int:
        """Steps from one line to the next."""
        return int(self.steps[1] - self.steps[0]) if self.lines > 1 else 1
