"""What goes wrong in a scan, and when: fault plans.

A `FaultPlan` is a list of faults that a person writes, a seed draws, and JSON keeps. `Faults` is a plan under way: it counts the
opportunities of each kind of fault and says when one is due. Whoever wraps a device, a destination or an event loop asks it:
`scanhsi.testing.faulty_camera`, ``faulty_actuator``, ``faulty_light``, ``faulty_storage``, ``faulty_loop``;
`scanhsi.testing.instrument` puts all of them around an instrument of any driver. ::

    plan = FaultPlan(faults=(
        Fault(kind="frame incomplete", nth=7),
        Fault(kind="actuator unplugged", nth=12, after_s=0.004, for_s=2.0),
        Fault(kind="disk full", nth=3, lasts=1000),
    ))
"""

from __future__ import annotations

import math
import threading
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum, unique
from typing import Final, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator


@unique
class Kind(StrEnum):
    """What goes wrong; `ABOUT` says what an opportunity of each is, and which parameters it takes."""

    FRAME_LOST = "frame lost"
    FRAME_INCOMPLETE = "frame incomplete"
    FRAME_LATE = "frame late"
    FRAME_TWICE = "frame twice"
    FRAMES_SWAPPED = "frames swapped"
    FRAME_ID_WRAPS = "frame id wraps"
    METADATA_STALE = "metadata stale"
    CAMERA_SILENT = "camera silent"
    EXPOSURE_HANGS = "exposure hangs"
    EXPOSURE_LONGER = "exposure longer"
    TEMPERATURE_DRIFTS = "temperature drifts"
    SETTINGS_REFUSED = "settings refused"
    CONTROL_LOST = "control lost"
    CAMERA_UNPLUGGED = "camera unplugged"

    MOVE_SLOW = "move slow"
    REPLY_LOST = "reply lost"
    DONE_LOST = "done lost"
    STEPS_LOST = "steps lost"
    MOTOR_STALLS = "motor stalls"
    LIMIT_HIT = "limit hit"
    CONTROLLER_RESET = "controller reset"
    HOME_WRONG = "home wrong"
    STOP_UNANSWERED = "stop unanswered"
    ACTUATOR_UNPLUGGED = "actuator unplugged"

    LIGHT_UNANSWERED = "light unanswered"

    BYTE_GARBLED = "byte garbled"
    BYTE_DROPPED = "byte dropped"
    BYTE_TWICE = "byte twice"

    WRITE_SLOW = "write slow"
    DISK_FULL = "disk full"
    IO_ERROR = "i/o error"
    PERMISSION_LOST = "permission lost"
    NO_HANDLES = "no file handles"
    KILLED = "killed"
    POWER_CUT = "power cut"

    LOOP_STALLS = "loop stalls"
    GIL_HOG = "gil hog"
    CLOCK_STEP = "clock step"
    PAUSED = "paused"
    STOP_REQUESTED = "stop requested"
    CANCELLED = "cancelled"


@dataclass(frozen=True, slots=True)
class About:
    """What a kind of fault is.

    Attributes:
        opportunity: What is counted by ``nth``.
        effect: What happens.
        takes: Parameters that have a meaning, of ``after_s``, ``for_s``, ``by``; ``for_s`` None means for ever.
    """

    opportunity: str
    effect: str
    takes: frozenset[str] = frozenset()


def _about(opportunity: str, effect: str, *takes: str) -> About:
    return About(opportunity, effect, frozenset(takes))


ABOUT: Final = {
    Kind.FRAME_LOST: _about("frame", "it never comes, and no word of it"),
    Kind.FRAME_INCOMPLETE: _about("frame", "it is reported as a gap: packets are missing"),
    Kind.FRAME_LATE: _about("frame", "it, and all behind it, come for_s later", "for_s"),
    Kind.FRAME_TWICE: _about("frame", "it comes twice"),
    Kind.FRAMES_SWAPPED: _about("frame", "it comes behind the next one"),
    Kind.FRAME_ID_WRAPS: _about("frame", "the camera's frame numbers wrap from 65535 to 1 with the next one"),
    Kind.METADATA_STALE: _about("frame", "its number and device time are those of the frame before"),
    Kind.CAMERA_SILENT: _about("frame", "no frame comes for for_s, those of that time are lost", "for_s"),
    Kind.EXPOSURE_HANGS: _about("exposure", "the end of the exposure is not told for for_s", "for_s"),
    Kind.EXPOSURE_LONGER: _about("exposure", "the shutter stays open for_s longer than asked", "for_s"),
    Kind.TEMPERATURE_DRIFTS: _about("frame", "from it on the dark level rises, by counts a second", "by"),
    Kind.SETTINGS_REFUSED: _about("call of configure", "OutOfRange, though the settings are within the limits"),
    Kind.CONTROL_LOST: _about(
        "call of the camera", "DeviceLost after after_s; it can be opened again at once", "after_s"
    ),
    Kind.CAMERA_UNPLUGGED: _about(
        "call of the camera", "gone after after_s, there again for_s later", "after_s", "for_s"
    ),
    Kind.MOVE_SLOW: _about("motion", "it begins for_s late", "for_s"),
    Kind.REPLY_LOST: _about(
        "motion", "it is made, but instead of an answer comes a DeviceTimeout for_s later", "for_s"
    ),
    Kind.DONE_LOST: _about("motion", "its end is told for_s late", "for_s"),
    Kind.STEPS_LOST: _about("motion", "it ends by steps short, and nobody knows", "by"),
    Kind.MOTOR_STALLS: _about(
        "motion", "it stands still after after_s; a DeviceTimeout for_s later", "after_s", "for_s"
    ),
    Kind.LIMIT_HIT: _about("motion", "a switch stops it after after_s: MotionFailed", "after_s"),
    Kind.CONTROLLER_RESET: _about("motion", "it stops after after_s and the position is lost", "after_s"),
    Kind.HOME_WRONG: _about("homing", "it ends by steps beside the home position", "by"),
    Kind.STOP_UNANSWERED: _about("call of stop", "no answer; a DeviceTimeout for_s later, the mirror goes on", "for_s"),
    Kind.ACTUATOR_UNPLUGGED: _about(
        "call of the actuator", "gone after after_s, there again for_s later", "after_s", "for_s"
    ),
    Kind.LIGHT_UNANSWERED: _about(
        "switching of the light", "no answer; a DeviceTimeout for_s later, it stays as it is", "for_s"
    ),
    Kind.BYTE_GARBLED: _about("byte on the line", "one bit of it flips"),
    Kind.BYTE_DROPPED: _about("byte on the line", "it does not arrive"),
    Kind.BYTE_TWICE: _about("byte on the line", "it arrives twice"),
    Kind.WRITE_SLOW: _about("write", "it takes for_s", "for_s"),
    Kind.DISK_FULL: _about("write", "ENOSPC"),
    Kind.IO_ERROR: _about("write", "EIO"),
    Kind.PERMISSION_LOST: _about("write", "EACCES"),
    Kind.NO_HANDLES: _about("write", "EMFILE: too many open files"),
    Kind.KILLED: _about("write", "the process is killed before it: this and all later ones are not made"),
    Kind.POWER_CUT: _about("write", "as killed, and what was not synced before is gone"),
    Kind.LOOP_STALLS: _about("callback of the event loop", "it takes for_s, and all others wait", "for_s"),
    Kind.GIL_HOG: _about("callback of the event loop", "a thread keeps the interpreter busy for for_s", "for_s"),
    Kind.CLOCK_STEP: _about("look at the wall clock", "from it on the wall clock is by seconds ahead", "by"),
    Kind.PAUSED: _about("callback of the event loop", "the scan is asked to pause, for_s later to go on", "for_s"),
    Kind.STOP_REQUESTED: _about("callback of the event loop", "the scan is asked to stop: the first Ctrl-C"),
    Kind.CANCELLED: _about("callback of the event loop", "the scan is cancelled: the second Ctrl-C"),
}
"""What each kind of fault is."""


class Fault(BaseModel):
    """One fault.

    Attributes:
        kind: What goes wrong; see `ABOUT`.
        nth: At which of its opportunities, from 0 (the frames of a camera, the calls of ``move_to``, the writes, ...), counted
            from the begin of the plan; repeated and late ones count as well.
        at_s: Instead: at the first opportunity so long after the begin, on the loop clock.
        lasts: How many opportunities in a row.
        after_s: How long after the begin of what it happens in.
        for_s: How late, how long; None: for ever.
        by: How much: steps, counts, seconds.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    kind: Kind
    nth: int | None = Field(default=None, ge=0)
    at_s: float | None = Field(default=None, ge=0)
    lasts: int = Field(default=1, ge=1)
    after_s: float = Field(default=0.0, ge=0)
    for_s: float | None = Field(default=None, ge=0)
    by: float = 0.0

    @model_validator(mode="after")
    def _has_a_meaning(self) -> Self:
        if (self.nth is None) == (self.at_s is None):
            raise ValueError(f"{self.kind}: give nth, or at_s: when it happens")
        given = {name for name in ("after_s", "for_s", "by") if getattr(self, name) not in (None, 0)}
        if wrong := sorted(given - ABOUT[self.kind].takes):
            raise ValueError(f"{self.kind} knows no {', '.join(wrong)}; it takes {sorted(ABOUT[self.kind].takes)}")
        return self

    def __str__(self) -> str:
        when = f"{ABOUT[self.kind].opportunity} {self.nth}" if self.nth is not None else f"after {self.at_s:g} s"
        more = f" and {self.lasts - 1} more" if self.lasts > 1 else ""
        return f"{self.kind} at {when}{more}"


class FaultPlan(BaseModel):
    """Everything that goes wrong.

    Attributes:
        faults: Each by itself; several may be due at the same time.
        seed: Of what the faults themselves leave to chance (which bit flips).
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    faults: tuple[Fault, ...] = ()
    seed: int = Field(default=0, ge=0)


@dataclass(frozen=True, slots=True)
class Happened:
    """A fault that happened.

    Attributes:
        fault: Which.
        at_ns: When, on the clock of `Faults`.
        opportunity: Number of its opportunity.
    """

    fault: Fault
    at_ns: int
    opportunity: int


class Faults:
    """A plan under way. May be asked from several threads.

    Args:
        plan: What goes wrong.
        clock_ns: Tells the time; needed for faults with ``at_s`` only.
    """

    def __init__(self, plan: FaultPlan, clock_ns: Callable[[], int] = lambda: 0) -> None:
        self.plan = plan
        self.happened: list[Happened] = []
        self._clock_ns = clock_ns
        self._begun_ns: int | None = None
        self._lock = threading.Lock()
        self._counts: dict[Kind, int] = defaultdict(int)
        self._waiting: dict[Kind, list[Fault]] = defaultdict(list)
        self._left: dict[int, int] = {}
        for fault in plan.faults:
            self._waiting[fault.kind].append(fault)

    def has(self, *kinds: Kind) -> bool:
        """Whether the plan has any of these."""
        return any(kind in self._waiting for kind in kinds)

    def begin(self, clock_ns: Callable[[], int] | None = None) -> None:
        """The time from which ``at_s`` counts; otherwise the first opportunity of any kind is."""
        if clock_ns is not None:
            self._clock_ns = clock_ns
        self._begun_ns = self._clock_ns()

    def due(self, kind: Kind) -> Fault | None:
        """One opportunity of a kind: the fault that happens at it, or None."""
        if kind not in self._waiting:
            return None
        with self._lock:
            number = self._counts[kind]
            self._counts[kind] = number + 1
            now_ns = self._clock_ns()
            if self._begun_ns is None:
                self._begun_ns = now_ns
            for fault in self._waiting[kind]:
                if self._is_due(fault, number, now_ns - self._begun_ns):
                    self.happened.append(Happened(fault, now_ns, number))
                    return fault
        return None

    def _is_due(self, fault: Fault, number: int, since_ns: int) -> bool:
        if fault.nth is not None:
            return fault.nth <= number < fault.nth + fault.lasts
        assert fault.at_s is not None
        left = self._left.setdefault(id(fault), fault.lasts)
        if not left or since_ns < fault.at_s * 1e9:
            return False
        self._left[id(fault)] = left - 1
        return True

    def kinds(self) -> set[Kind]:
        """Kinds that have happened."""
        return {happened.fault.kind for happened in self.happened}


NO_FAULTS: Final = FaultPlan()


def for_ever_s(for_s: float | None) -> float:
    """A duration as a number: None is infinite."""
    return math.inf if for_s is None else for_s
