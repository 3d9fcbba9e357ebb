"""What is known of each line besides its pixels: status, positions, frame numbers and time stamps.

One preallocated array a column, one entry a line: the engine writes entries as a line passes through its stages, the cube
stores the columns beside the pixels. Nothing is allocated per line.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from enum import IntEnum, unique
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

NOT_STAMPED: Final = int(np.iinfo(np.int64).min)
"""A stamp that was never taken (numpy's NaT)."""

STAGES: Final = (
    "commanded",
    "started",
    "moved",
    "trigger",
    "exposure_start",
    "exposure_end",
    "first_byte",
    "received",
    "copied",
    "stored",
)
"""Stages of a line in order; each has a column ``<stage>_ns`` on the loop clock.

commanded: the mirror was told to go to this line's step. started: it began to move, where the driver can tell, and never later
than it did. moved: motion and settle had ended. trigger: the trigger was sent.
exposure_start, exposure_end: as well as the driver knows them. first_byte: of the frame, where known. received: the frame is
whole in memory. copied: its pixels are unpacked in the line buffer. stored: its data is safe on disk.
"""


@unique
class LineStatus(IntEnum):
    """What became of a line. 0 never means anything but "nothing safe is here"."""

    NOT_STORED = 0
    STORED = 1
    MISSING = 2


@dataclass(frozen=True, slots=True)
class Incident:
    """Something that kept a scan from going on for a while, and what was done about it.

    Attributes:
        kind: A fault, or a pause that somebody asked for.
        line: The line that was to be taken when it came, and with which the scan went on, if it did.
        at_ns: When it came, loop clock; in a cube the clock of its stamps.
        lasted_s: Until the scan went on, or ended.
        device: Whose fault it was, as messages call the device.
        cause: What happened.
        action: What was done.
    """

    kind: Literal["fault", "pause"]
    line: int
    at_ns: int
    lasted_s: float
    device: str
    cause: str
    action: str

    def to_json(self, shift_ns: int = 0) -> dict[str, Any]:
        """As plain JSON types, on a clock that is so much ahead."""
        return {**asdict(self), "at_ns": self.at_ns + shift_ns}

    @classmethod
    def from_json(cls, value: dict[str, Any], shift_ns: int = 0) -> Incident:
        """The opposite of `to_json`."""
        return replace(cls(**value), at_ns=value["at_ns"] - shift_ns)


class LineRecords:
    """Columns of one scan, one entry a line.

    Attributes:
        lines: Number of lines.
        stamps: Stage name -> int64 column in ns, `NOT_STAMPED` where never taken.
        status: uint8 column of `LineStatus`; set by the sink as lines become safe, or missing by `mark_missing`.
        mirror_step: int64 column: step at which the line was taken, as the actuator confirmed it (in a sweep: step of the
            trigger or, free-running, of the middle of the exposure, rounded).
        mirror_angle_rad: float64 column: mirror angle from the normal; nan where not taken.
        frame_id: int64 column: the camera's own frame number; -1 is no valid number and means none.
        device_ns: int64 column: the camera's own time stamp, its own epoch.
        smeared: uint8 column: 1 where look-ahead moved the mirror before the exposure had ended.
        attempt: uint16 column: how often the line was tried; 0 where it never was.
        run: uint16 column: session that took the line: 0 for the one that began the cube, n for the n-th that resumed it.
        missing: line -> reason, of lines that will never be stored.
        incidents: What kept the scan from going on for a while, in order.
    """

    def __init__(self, lines: int) -> None:
        self.lines = lines
        self.stamps: dict[str, NDArray[np.int64]] = {stage: np.full(lines, NOT_STAMPED, np.int64) for stage in STAGES}
        self.status: NDArray[np.uint8] = np.zeros(lines, np.uint8)
        self.mirror_step: NDArray[np.int64] = np.zeros(lines, np.int64)
        self.mirror_angle_rad: NDArray[np.float64] = np.full(lines, np.nan)
        self.frame_id: NDArray[np.int64] = np.full(lines, -1, np.int64)
        self.device_ns: NDArray[np.int64] = np.full(lines, NOT_STAMPED, np.int64)
        self.smeared: NDArray[np.uint8] = np.zeros(lines, np.uint8)
        self.attempt: NDArray[np.uint16] = np.zeros(lines, np.uint16)
        self.run: NDArray[np.uint16] = np.zeros(lines, np.uint16)
        self.missing: dict[int, str] = {}
        self.incidents: list[Incident] = []

    def mark_missing(self, line: int, reason: str) -> None:
        """A line will never be stored. The first reason stands."""
        self.missing.setdefault(line, reason)

    def forget(self, first: int) -> None:
        """Forget what is known of the lines from ``first`` on, which will be taken again; not how often they were tried."""
        for column in self.stamps.values():
            column[first:] = NOT_STAMPED
        self.mirror_step[first:] = 0
        self.frame_id[first:] = -1
        self.device_ns[first:] = NOT_STAMPED
        self.smeared[first:] = 0

    @property
    def stored(self) -> int:
        """Number of lines that are safe on disk."""
        return int(np.count_nonzero(self.status == LineStatus.STORED))
