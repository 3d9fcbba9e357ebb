"""Live pictures: the latest frame, and the growing colour picture of a scan. Viewers take what is there when they are ready.

The scan pays for a copy of what is looked at, and nothing else: pictures are made in threads of low priority, and one that is not
ready when the next frame comes is simply made of a later frame. A viewer has no queue: it is told that there is something new, and
takes the newest when it has sent the last.
"""

from __future__ import annotations

import asyncio
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from scanhsi.clock import now_ns
from scanhsi.cube.records import LineRecords
from scanhsi.devices.frames import Pixels
from scanhsi.service.background import Background
from scanhsi.service.pictures import FrameView, RowMaker, message, view_frame

MOST_A_SECOND: Final = 15
WHILE_SCANNING: Final = 5
"""Frames a second: beside a scan the colour picture is what one looks at."""
MOST_ROWS: Final = 4096


@dataclass(slots=True)
class Showing:
    """What is shown now.

    Attributes:
        name: ``live``, or the id of a job.
        lines: Planned; 0 for a live view, which has no colour picture.
        exposure_s: Of a frame.
        bits: Significant bits of a count.
        rows: Makes rows of the colour picture.
        lines_per_row: Of the colour picture.
    """

    name: str
    lines: int
    exposure_s: float
    bits: int
    rows: RowMaker | None = None
    lines_per_row: int = 1


@dataclass(frozen=True, slots=True)
class Seen:
    """A line that passed.

    Attributes:
        line: Its number.
        received_ns: When its frame was in memory, loop clock.
        pixels: A copy; None where only the colour picture is wanted.
    """

    line: int
    received_ns: int
    pixels: Pixels | None


class Viewer:
    """Somebody who looks; made by `Preview.viewing`."""

    def __init__(self, preview: Preview) -> None:
        self._preview = preview
        self.news = asyncio.Event()
        self.news.set()
        self._frame = 0
        self._epoch = 0
        self._row = 0

    async def next(self) -> list[bytes]:
        """The newest messages that this viewer has not had; waits for one."""
        while True:
            found = self.take()
            if found:
                return found
            self.news.clear()
            await self.news.wait()

    def take(self) -> list[bytes]:
        """The same without waiting: perhaps none."""
        preview, found = self._preview, list[bytes]()
        if preview.frame_seq != self._frame and preview.frame is not None:
            self._frame = preview.frame_seq
            found.append(preview.frame)
        if preview.epoch != self._epoch:
            self._epoch, self._row = preview.epoch, 0
        if preview.rows_made > self._row:
            found.append(preview.rows_since(self._row))
            self._row = preview.rows_made
        return found


class Preview:
    """Makes pictures of what passes.

    Args:
        background: Where.
    """

    def __init__(self, background: Background) -> None:
        self._background = background
        self._viewers: set[Viewer] = set()
        self._showing: Showing | None = None
        self._making: asyncio.Task[None] | None = None
        self._last_ns = -(10**18)
        self._previous: Pixels | None = None
        self._spare: Pixels | None = None
        self._thin: list[tuple[int, Pixels]] = []
        self._picture: NDArray[np.uint8] = np.zeros((0, 1, 3), np.uint8)
        self.frame: bytes | None = None
        self.facts: dict[str, Any] | None = None
        self.frame_seq = 0
        self.epoch = 0
        self.rows_made = 0

    @property
    def viewers(self) -> int:
        """How many look."""
        return len(self._viewers)

    @contextmanager
    def viewing(self) -> Generator[Viewer]:
        """Look while entered."""
        viewer = Viewer(self)
        self._viewers.add(viewer)
        try:
            yield viewer
        finally:
            self._viewers.discard(viewer)

    def begin(
        self,
        name: str,
        *,
        shape: tuple[int, int],
        bits: int,
        exposure_s: float,
        lines: int = 0,
        wavelength_nm: NDArray[np.float64] | None = None,
    ) -> None:
        """Something else comes to be seen.

        Args:
            name: ``live``, or the id of a job.
            shape: (bands, samples) of a line.
            bits: Significant bits of a count.
            exposure_s: Of a frame.
            lines: Of the colour picture; 0 for none.
            wavelength_nm: (bands,) where calibrated.
        """
        self._showing = Showing(name, lines, exposure_s, bits)
        self._previous = None
        if lines:
            self._showing.rows = RowMaker(*shape, wavelength_nm, bits)
            self._showing.lines_per_row = -(-lines // MOST_ROWS)
            rows = -(-lines // self._showing.lines_per_row)
            self._picture = np.zeros((rows, self._showing.rows.width, 3), np.uint8)
            self._thin, self.rows_made = [], 0
            self.epoch += 1

    def watch(self, line: int, pixels: Pixels, records: LineRecords) -> None:
        """See a line pass; see `scanhsi.cube.watched.Watch`."""
        showing = self._showing
        if showing is None:
            return
        if showing.rows is not None and line % showing.lines_per_row == 0:
            self._thin.append((line // showing.lines_per_row, showing.rows.thin(pixels)))
        if self._making is not None:
            return
        now = now_ns()
        due = now - self._last_ns >= 1e9 / (WHILE_SCANNING if showing.lines else MOST_A_SECOND) * 0.98
        wanted = bool(self._viewers) and due
        if wanted or self._thin:
            self._last_ns = now if wanted else self._last_ns
            copy = self._copied(pixels) if wanted else None
            seen = Seen(line, int(records.stamps["received"][line]), copy)
            self._making = asyncio.get_running_loop().create_task(self._make(showing, seen), name="preview")

    def _copied(self, pixels: Pixels) -> Pixels:
        """A copy, in memory that was used before: fresh pages would cost more than the copying."""
        copy = self._spare
        if copy is None or copy.shape != pixels.shape or copy.dtype != pixels.dtype:
            copy = np.empty_like(pixels)
        self._spare = None
        np.copyto(copy, pixels)
        return copy

    async def finish(self) -> None:
        """What passed before is made visible."""
        while self._making is not None:
            await asyncio.wait([self._making])
        if self._thin and self._showing is not None:
            await self._make(self._showing, Seen(self._showing.lines, 0, None))

    async def _make(self, showing: Showing, seen: Seen) -> None:
        thin, self._thin = self._thin, []
        try:
            view, rows = await self._background.run(_made, showing, thin, seen.pixels, self._previous)
        finally:
            self._making = None
        if showing is not self._showing:
            return
        if view is not None:
            self._spare, self._previous = self._previous, seen.pixels
            self._show(showing, seen, view)
        if rows is not None:  # a row whose line was lost stays black
            self._picture[[row for row, _ in thin]] = rows
            self.rows_made = thin[-1][0] + 1
        for viewer in self._viewers:
            viewer.news.set()

    def _show(self, showing: Showing, seen: Seen, view: FrameView) -> None:
        self.frame_seq += 1
        self.facts = {
            "kind": "frame",
            "seq": self.frame_seq,
            "t_ns": now_ns(),
            "of": showing.name,
            "line": seen.line,
            "received_ns": seen.received_ns,
            "exposure_s": showing.exposure_s,
            "dtype": "u8",
            "shape": list(view.picture.shape),
            **view.facts,
        }
        self.frame = message(self.facts, view.picture.data)

    def rows_since(self, first: int) -> bytes:
        """Rows of the colour picture from one on."""
        showing = self._showing
        rows = self._picture[first : self.rows_made]
        header = {
            "kind": "rows",
            "seq": self.rows_made,
            "t_ns": now_ns(),
            "of": showing.name if showing else "",
            "epoch": self.epoch,
            "first": first,
            "dtype": "u8",
            "shape": list(rows.shape),
            "rows": len(self._picture),
            "lines": showing.lines if showing else 0,
            "lines_per_row": showing.lines_per_row if showing else 1,
        }
        return message(header, rows.tobytes())


def _made(
    showing: Showing, thin: list[tuple[int, Pixels]], frame: Pixels | None, previous: Pixels | None
) -> tuple[FrameView | None, NDArray[np.uint8] | None]:
    view = None if frame is None else view_frame(frame, previous, showing.bits)
    rows = np.stack([showing.rows.row(line) for _, line in thin]) if thin and showing.rows is not None else None
    return view, rows
