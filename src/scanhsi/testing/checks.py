"""What must hold after every scan, whatever went wrong: the invariants that the fuzz checks."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from scanhsi.clock import HoldTimeout, VirtualDeadlock
from scanhsi.cube import LineStatus
from scanhsi.cube.records import NOT_STAMPED
from scanhsi.devices.errors import DeviceUnsafe, ScanFailed, ScanhsiError
from scanhsi.engine import Mode
from scanhsi.engine.deadlines import STORE_S
from scanhsi.engine.plan import OnFault
from scanhsi.testing.faults import Fault, Kind
from scanhsi.testing.faulty_camera import warmed
from scanhsi.testing.faulty_frames import PACKETS_MISSING
from scanhsi.testing.faulty_loop import EPOCH_NS
from scanhsi.testing.runs import Outcome, resume
from scanhsi.testing.snapshot import Snapshot, snapshot
from scanhsi.testing.witness import Sight

SLOTS: Final = 3
"""Shards that a writer keeps in memory."""

_SMALL_S: Final = 0.75
"""A delay that no deadline of the engine can mind."""


@dataclass(frozen=True, slots=True)
class Violation:
    """An invariant that does not hold.

    Attributes:
        name: Which.
        text: How it shows.
    """

    name: str
    text: str

    def __str__(self) -> str:
        return f"{self.name}: {self.text}"


def check(outcome: Outcome) -> list[Violation]:
    """Every violation of one scan."""
    found = [Violation(name, text) for name, look in _CHECKS for text in look(outcome)]
    found += _of_the_cube(outcome)
    if outcome.case.resumes and not found and not outcome.hung:
        found += [Violation("it cannot be resumed", text) for text in _resumed(outcome)]
    return found


def _of_the_cube(outcome: Outcome) -> list[Violation]:
    if outcome.place is None or outcome.hung:
        return []
    try:
        cube = snapshot(outcome.place)
    except Exception as error:
        return [Violation("the cube is not valid", f"{type(error).__name__}: {error}")]
    if cube is None:
        return [*_without_cube(outcome)]
    return [Violation(name, text) for name, look in _CHECKS_OF_CUBES for text in look(outcome, cube)]


# --- how it ended ---------------------------------------------------------------------------------------------------------


def _hangs(outcome: Outcome) -> Iterator[str]:
    if outcome.hung:
        yield f"not over after {outcome.case.deadline_s:g} s of virtual time"
    if isinstance(outcome.error, VirtualDeadlock | HoldTimeout):
        yield str(outcome.error)


def _leaves(outcome: Outcome) -> Iterator[str]:
    if not _stuck(outcome):  # storage that does not answer is left behind
        yield from outcome.left
    yield from outcome.unhandled


def _stuck(outcome: Outcome) -> bool:
    happened = outcome.faults.happened
    slow_s = sum(one.fault.for_s or 0.0 for one in happened if one.fault.kind is Kind.WRITE_SLOW)
    return slow_s > STORE_S / 2


def _unsafe(outcome: Outcome) -> Iterator[str]:
    """The mirror stands, the camera is disarmed and the light is off, or somebody was told that it is not so."""
    if not outcome.disarmed:
        yield "the camera is armed"
    unanswered = Kind.LIGHT_UNANSWERED in outcome.faults.kinds()
    if not outcome.dark and not (unanswered and (outcome.cancelled or "the light may be on" in str(outcome.error))):
        yield f"the light is on, told: {outcome.error}"
    if outcome.mirror_still:
        return
    excuse = outcome.faults.kinds() & {Kind.STOP_UNANSWERED, Kind.ACTUATOR_UNPLUGGED}
    told = outcome.cancelled or re.search(r"\bstop\b|unsafe", str(outcome.error))
    if not excuse or not told:
        yield f"the mirror moves; excuse: {sorted(excuse)}, told: {outcome.error}"


def _wrong_exception(outcome: Outcome) -> Iterator[str]:
    error = outcome.error
    if outcome.cancelled and not outcome.cancellations and not outcome.hung:
        yield "it ended as cancelled, and nobody had cancelled it"
    if outcome.cancellations and not outcome.cancelled:
        yield f"a cancellation was swallowed; it ended with {error!r}"
    if error is None or isinstance(error, VirtualDeadlock | HoldTimeout):
        return
    expected = ScanFailed if outcome.witness.moved and outcome.stage == "scan" else ScanhsiError
    if not isinstance(error, expected):
        yield f"{type(error).__name__} instead of {expected.__name__}: {error}"
    for cause in error.causes if isinstance(error, ScanFailed) else ():
        if not isinstance(cause, ScanhsiError):  # a bug, however well it is wrapped
            yield f"{type(cause).__name__} as a cause: {cause}"


def _memory(outcome: Outcome) -> Iterator[str]:
    witness = outcome.witness
    if witness.most_frames > max(witness.buffers, 1):
        yield f"{witness.most_frames} frames at once, and {witness.buffers} buffers"


def _moving_while_exposing(outcome: Outcome) -> Iterator[str]:
    plan = outcome.plan
    if plan.mode is Mode.CONTINUOUS or plan.look_ahead is not None:
        return  # see `_smeared` for what look-ahead accepts
    for sight in outcome.witness.sights.values():
        if not sight.still:
            yield f"exposure {sight.number}: from step {sight.span[0]} to {sight.span[1]}"


def _fails_needlessly(outcome: Outcome) -> Iterator[str]:
    """What is harmless must not end a scan, nor cost a line."""
    if outcome.cancellations or any(not _harmless(happened.fault) for happened in outcome.faults.happened):
        return
    if outcome.error is not None:
        yield f"{type(outcome.error).__name__}: {outcome.error}"
    elif outcome.report is not None and outcome.report.missing:
        yield f"lines are missing: {outcome.report.missing_reasons}"


_HARMLESS: Final = frozenset(
    {
        Kind.FRAME_TWICE,
        Kind.FRAME_ID_WRAPS,
        Kind.TEMPERATURE_DRIFTS,
        Kind.STEPS_LOST,
        Kind.HOME_WRONG,
        Kind.CLOCK_STEP,
        Kind.STOP_REQUESTED,
        Kind.PAUSED,
        Kind.KILLED,
        Kind.POWER_CUT,
    }
)
_HARMLESS_IF_SHORT: Final = frozenset({Kind.DONE_LOST, Kind.MOVE_SLOW, Kind.EXPOSURE_LONGER, Kind.EXPOSURE_HANGS})


def _harmless(fault: Fault) -> bool:
    short = fault.for_s is not None and fault.for_s <= _SMALL_S
    return fault.kind in _HARMLESS or (fault.kind in _HARMLESS_IF_SHORT and short)


def _gives_up(outcome: Outcome) -> Iterator[str]:
    """One fault that can be mended ends no scan that is to try again, and in step modes costs no line."""
    plan, error = outcome.plan, outcome.error
    limits = {"line_retries", "retries", "recover_within_s"}
    if plan.on_fault is not OnFault.RETRY or limits & outcome.case.plan.keys() or outcome.cancelled:
        return
    serious = [one.fault for one in outcome.faults.happened if not _harmless(one.fault)]
    if len(serious) != 1 or not _mendable(serious[0]):
        return
    if isinstance(error, ScanFailed) and not _only_unsafe(error):
        yield f"after {serious[0]}: {error}"
    if outcome.report is not None and outcome.report.missing and plan.mode is not Mode.CONTINUOUS:
        yield f"after {serious[0]}: {outcome.report.missing_reasons}"


def _only_unsafe(error: ScanFailed) -> bool:
    """All lines are there, but a device that had gone by then cannot be made safe, which has to be told."""
    return error.stored == error.lines and all(isinstance(cause, DeviceUnsafe) for cause in error.causes)


_BACK_S: Final = 6.0
_MENDABLE: Final = frozenset(
    {Kind.FRAME_LOST, Kind.FRAME_INCOMPLETE, Kind.CONTROL_LOST, Kind.CONTROLLER_RESET, Kind.LIMIT_HIT}
)
_MENDABLE_IF_SHORT: Final = frozenset(
    {
        Kind.CAMERA_UNPLUGGED,
        Kind.ACTUATOR_UNPLUGGED,
        Kind.CAMERA_SILENT,
        Kind.FRAME_LATE,
        Kind.MOTOR_STALLS,
        Kind.REPLY_LOST,
    }
)


def _mendable(fault: Fault) -> bool:
    short = fault.for_s is not None and fault.for_s <= _BACK_S
    return fault.kind in _MENDABLE or (fault.kind in _MENDABLE_IF_SHORT and short)


_CHECKS: Final[tuple[tuple[str, Callable[[Outcome], Iterator[str]]], ...]] = (
    ("it hangs", _hangs),
    ("something is left", _leaves),
    ("it is not safe", _unsafe),
    ("the wrong exception", _wrong_exception),
    ("memory beyond the credits", _memory),
    ("the mirror moved in an exposure", _moving_while_exposing),
    ("it failed needlessly", _fails_needlessly),
    ("it did not recover", _gives_up),
)


# --- what is in the cube --------------------------------------------------------------------------------------------------


def _without_cube(outcome: Outcome) -> Iterator[Violation]:
    if outcome.report is not None and not outcome.over:
        yield Violation("the cube is not valid", "the scan ended well, and there is none")
    if outcome.claimed and outcome.case.durability == "every shard":
        yield Violation("what was stored is lost", f"{outcome.claimed} lines, and the cube with them")


def _consistent(outcome: Outcome, cube: Snapshot) -> Iterator[str]:
    reached = cube.reached
    if np.any(cube.status[:reached] == LineStatus.NOT_STORED) or np.any(cube.status > LineStatus.MISSING):
        yield f"status {cube.status.tolist()}"
    lost = set(np.flatnonzero(cube.status == LineStatus.MISSING).tolist())
    if lost - set(cube.missing):
        yield f"lines {sorted(lost - set(cube.missing))} are missing without a reason"
    if set(cube.missing) & set(np.flatnonzero(cube.status == LineStatus.STORED).tolist()):
        yield "a line is stored and has a reason for being missing"
    for line in lost & set(range(len(cube.pixels))):
        if cube.pixels[line].any():
            yield f"line {line} is missing, and has pixels"


def _counted(outcome: Outcome, cube: Snapshot) -> Iterator[str]:
    if outcome.claimed > cube.stored and not _torn(outcome):
        yield f"{outcome.claimed} lines were said to be stored, {cube.stored} are"
    if outcome.over:
        return
    report, error = outcome.report, outcome.error
    if report is not None:
        told = report.stored, report.missing
        if told != (cube.stored, cube.reached - cube.stored):
            yield f"the report says {told} stored and missing, the cube has {cube.stored}, {cube.reached - cube.stored}"
        if report.missing_reasons != cube.missing:
            yield f"reasons in the report {report.missing_reasons}, in the cube {cube.missing}"
        if report.stopped_early != (cube.reached < outcome.plan.lines):
            yield f"{cube.reached} lines were reached, and the report says stopped_early={report.stopped_early}"
        if report.stopped_early and Kind.STOP_REQUESTED not in outcome.faults.kinds():
            yield f"only {cube.reached} lines were reached, and nobody had asked to stop"
    if isinstance(error, ScanFailed) and error.stored > cube.stored:
        yield f"ScanFailed says {error.stored} lines are safe, {cube.stored} are"


def _true(outcome: Outcome, cube: Snapshot) -> Iterator[str]:
    """Each stored line shows what the mirror truly looked at while it was exposed, which was where the line is."""
    used: dict[int, int] = {}
    for line in np.flatnonzero(cube.status == LineStatus.STORED).tolist():
        start_ns = int(cube.column("exposure_start_ns")[line])
        if cube.column("run")[line]:  # on the clock of the session that began the cube
            start_ns += cube.attributes["clock_offset_ns"] - EPOCH_NS
        sight = outcome.witness.sights.get(start_ns)
        if sight is None:
            yield f"line {line}: nothing was exposed at {start_ns}"
            continue
        if start_ns in used:
            yield f"lines {used[start_ns]} and {line} are of one exposure"
        used[start_ns] = line
        yield from _line_is_true(outcome, cube, line, sight)


def _line_is_true(outcome: Outcome, cube: Snapshot, line: int, sight: Sight) -> Iterator[str]:
    where = f"line {line} of exposure {sight.number}"
    plan = outcome.plan
    due = int(plan.steps(0)[line])
    low, high = sight.reported
    if plan.mode is Mode.CONTINUOUS:
        near = (high if plan.step < 0 and plan.lines > 1 else low) == due
    elif plan.look_ahead is not None:
        near = due in (low, high) if sight.still or cube.column("smeared")[line] else False
        if not sight.still and not cube.column("smeared")[line]:
            yield f"{where}: the mirror moved, and the line is not flagged as smeared"
            return
    else:
        near = low == high == due
    if not sight.homed:
        yield f"{where}: nobody knew where the mirror was, it had not found its home"
    if not near:
        yield f"{where}: the mirror was at {low} to {high} and not at {due}"
    told = int(cube.column("mirror_step")[line])
    if told != due:
        yield f"{where}: the cube says step {told}, it is {due}"
    if sight.frame_id is not None and int(cube.column("frame_id")[line]) != sight.frame_id:
        yield f"{where}: the cube says frame {cube.column('frame_id')[line]}, it was {sight.frame_id}"
    wrong = int(np.count_nonzero(cube.pixels[line] != expected(outcome, sight)))
    if wrong:
        yield f"{where}: {wrong} of {cube.pixels[line].size} pixels are wrong"


def expected(outcome: Outcome, sight: Sight) -> NDArray[Any]:
    """The pixels that a line of that exposure must have."""
    case = outcome.case
    bits = outcome.plan.pixel_format.bits
    warm = outcome.witness.warmth(sight.start_ns)
    pixels = warmed(sight.pixels, warm, bits) if warm else sight.pixels
    if case.bin_samples == 1:
        return pixels
    bands, samples = pixels.shape[0], pixels.shape[1] // case.bin_samples
    binned = pixels[:, : samples * case.bin_samples].reshape(bands, samples, case.bin_samples)
    return binned.sum(axis=2, dtype=np.uint32)


def _credited(outcome: Outcome, cube: Snapshot) -> Iterator[str]:
    """In step modes no line is exposed before there is room for it."""
    case = outcome.case
    if outcome.plan.mode is Mode.CONTINUOUS:
        return
    trigger, stored = cube.column("trigger_ns"), cube.column("stored_ns")
    room = SLOTS * case.lines_per_shard
    for line in range(room, cube.reached):
        before = stored[line - room]
        if trigger[line] != NOT_STAMPED and before != NOT_STAMPED and trigger[line] < before:
            yield f"line {line} was exposed {(before - trigger[line]) * 1e-9:g} s before line {line - room} was stored"


def _dated(outcome: Outcome, cube: Snapshot) -> Iterator[str]:
    """Times of lines are those of their exposures: the wall clock may jump as it likes."""
    stored = cube.status == LineStatus.STORED
    ahead = cube.column("time")[stored] - cube.column("exposure_start_ns")[stored]
    if len(ahead) and np.any(ahead != ahead[0]):
        yield "lines are dated by a wall clock that jumped"


_STALLED: Final = {Kind.LOOP_STALLS}  # beyond a deadline all else has waited, too: nobody can tell who was late
_NO_WORD: Final = {Kind.FRAME_LOST, Kind.FRAME_LATE, Kind.FRAMES_SWAPPED, Kind.CAMERA_SILENT}
_REASONS: Final = {
    PACKETS_MISSING: {Kind.FRAME_INCOMPLETE},
    "did not arrive within": _NO_WORD,
    "lost without a word": _NO_WORD,
    "no frame came": _NO_WORD,
    "camera was still busy": _NO_WORD | {Kind.METADATA_STALE},
    "no free": {Kind.WRITE_SLOW, Kind.FRAME_LATE, Kind.FRAMES_SWAPPED} | _STALLED,  # frames that come all at once
    "while the sensor was busy": _STALLED,
    "memory is full": _STALLED,
}
"""What a reason may say, and of which faults."""


def _reasoned(outcome: Outcome, cube: Snapshot) -> Iterator[str]:
    kinds = outcome.faults.kinds()
    for line, reason in cube.missing.items():
        causes = [of for word, of in _REASONS.items() if word in reason]
        if not any(of & kinds for of in causes):
            yield f"line {line} is missing: {reason!r}; what happened is {sorted(kinds)}"


def _resumed(outcome: Outcome) -> Iterator[str]:
    """Another session takes the lines that are left, and only those; in the end all are there and true."""
    before = None if outcome.place is None else snapshot(outcome.place)
    if before is None or outcome.place is None or before.attributes.get("complete"):
        return
    try:
        resume(outcome)
    except Exception as error:
        if not _torn(outcome):
            yield f"{type(error).__name__}: {error}"
        return
    cube = snapshot(outcome.place)
    assert cube is not None
    if not cube.attributes["complete"] or cube.reached != outcome.plan.lines:
        yield f"{cube.reached} of {outcome.plan.lines} lines, complete: {cube.attributes['complete']}"
    lost = {line: reason for line, reason in before.missing.items() if line < before.reached}  # others are taken now
    if cube.missing != lost:
        yield f"lines are missing that were not: {cube.missing}, before {lost}"
    if np.any(cube.pixels[: before.reached] != before.pixels):
        yield "lines of the first session have changed"
    yield from _true(outcome, cube)
    yield from _consistent(outcome, cube)


def _torn(outcome: Outcome) -> bool:
    """Whether a power cut may have left anything, for nobody had asked for more."""
    return outcome.case.durability == "at close" and Kind.POWER_CUT in outcome.faults.kinds()


_CHECKS_OF_CUBES: Final[tuple[tuple[str, Callable[[Outcome, Snapshot], Iterator[str]]], ...]] = (
    ("the cube is not valid", _consistent),
    ("what was stored is lost", _counted),
    ("a stored line is not true", _true),
    ("memory beyond the credits", _credited),
    ("a line has the wrong time", _dated),
    ("a reason does not match the fault", _reasoned),
)
