"""The work that every writer does: the same lines, as they come from a camera or as fast as they are taken."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Awaitable, Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from scanhsi.cube.layout import CubeSpec, Layout, choose_layout

FULL_GIGE_LPS: Final = 44.8
"""Lines of 1088 x 1200 u16 a second that a Gigabit Ethernet link carries: 117 MB/s."""

SLOTS: Final = 3
"""Shards in memory, for every writer that does not bring its own buffers: one fills, two are being written."""

_SAMPLE_S: Final = 0.03


@dataclass(frozen=True, slots=True)
class Work:
    """Lines to be written.

    Attributes:
        lines, bands, samples: Of the cube; pixels are 12 bit in uint16.
        rate: Lines a second; None: as fast as they are taken.
        lines_per_shard: None: what `choose_layout` says.
        filled: Each line is copied into the writer's memory, as an engine does. Else buffers keep what they got first: what is
            left is the writer alone.
    """

    lines: int
    bands: int = 1088
    samples: int = 1200
    rate: float | None = None
    lines_per_shard: int | None = None
    filled: bool = True

    @property
    def spec(self) -> CubeSpec:
        """Of the cube."""
        return CubeSpec(self.lines, self.bands, self.samples, np.uint16, 12)

    def layout(self, *, raw: bool = False) -> Layout:
        """As our writer lays it out."""
        return choose_layout(self.spec, self.lines_per_shard, whole_frames=raw)

    @property
    def raw_bytes(self) -> int:
        """Of all lines, uncompressed."""
        return self.lines * self.spec.line_bytes


class Writer(Protocol):
    """A writer at work; made in a running loop, for a path that is not there."""

    async def take(self, line: int, frame: NDArray[np.uint16] | None) -> None:
        """Copy a (band, sample) frame and hand it over; None: the buffer holds one already. Waits where there is no room."""
        ...

    async def finish(self) -> None:
        """Return when everything taken is on disk."""
        ...

    async def close(self) -> None:
        """What is left to do for a cube that opens: metadata, clean-up."""
        ...

    def read(self, line: int) -> NDArray[np.uint16]:
        """A line as it was stored: (band, sample)."""
        ...


def synthetic_lines(bands: int, samples: int, count: int) -> NDArray[np.uint16]:
    """12-bit frames with the noise of a CMV2000, which is what compression has to live with: (count, band, sample).

    Full well 13.5 ke-, read noise 13 e-; smooth spectra times illumination times texture; the mean is near 860 DN.
    """
    rng = np.random.default_rng(1)
    gain = 13_500 / 4095
    at_band, at_sample = np.linspace(0, 1, bands)[:, None], np.linspace(0, 1, samples)[None, :]
    spectrum = 0.25 + 0.75 * np.exp(-(((at_band - 0.45) / 0.25) ** 2))
    light = 1 - 0.5 * (2 * at_sample - 1) ** 2
    lines = np.empty((count, bands, samples), np.uint16)
    for line in range(count):
        texture = 1 + 0.25 * np.sin(60 * at_sample + line / 9) + 0.15 * np.sin(17 * at_sample * (1 + at_band))
        electrons = 1750 * gain * spectrum * light * texture
        noisy = electrons + rng.standard_normal((bands, samples), np.float32) * np.sqrt(electrons + 13**2)
        lines[line] = np.clip(noisy / gain, 0, 4095)
    return lines


@dataclass(frozen=True, slots=True)
class Taken:
    """What one writer needed.

    Attributes:
        wall_s, cpu_s: From the first line to everything on disk; CPU of all threads of the process, the copies of frames included.
        close_s: What came after.
        memory_mb: Peak of anonymous and shared memory of the process, without the benchmark's own lines.
        base_mb: The same before the writer was made.
        append_p50_ms, append_p99_ms, append_max_ms: How long handing over a line took, its copy included.
        late_p99_ms, late_max_ms: How long after it was due a line was taken; None flat out.
        stored_bytes: On disk.
    """

    wall_s: float
    cpu_s: float
    close_s: float
    memory_mb: float
    base_mb: float
    append_p50_ms: float
    append_p99_ms: float
    append_max_ms: float
    late_p99_ms: float | None
    late_max_ms: float | None
    stored_bytes: int

    def as_json(self) -> dict[str, Any]:
        """Plain, with figures that are worth writing down."""
        return {name: round(value, 5) if isinstance(value, float) else value for name, value in asdict(self).items()}


async def measure(work: Work, frames: NDArray[np.uint16], make: Callable[[], Awaitable[Writer]], path: Path) -> Taken:
    """Make a writer, hand all lines over, wait for the disk, close.

    Raises:
        ValueError: A line was stored otherwise than it was given.
    """
    own_mb = frames.nbytes / 1e6
    base_mb = memory_mb() - own_mb
    writer = await make()
    append, late = np.zeros(work.lines), np.zeros(work.lines)
    fill = work.lines if work.filled else SLOTS * work.layout(raw=True).lines_per_shard
    with Peak() as peak:
        start, cpu = time.perf_counter(), time.process_time()
        for line in range(work.lines):
            due = start if work.rate is None else start + line / work.rate
            if work.rate is not None:
                await asyncio.sleep(max(0.0, due - time.perf_counter()))
            before = time.perf_counter()
            await writer.take(line, frames[line % len(frames)] if line < fill else None)
            after = time.perf_counter()
            append[line], late[line] = after - before, after - due
        await writer.finish()
        wall_s, cpu_s = time.perf_counter() - start, time.process_time() - cpu
        await writer.close()
        close_s = time.perf_counter() - start - wall_s
    if work.filled:
        _check(work, frames, writer)
    p50, p99 = np.percentile(append, [50, 99]) * 1e3
    paced = work.rate is not None
    return Taken(
        wall_s=wall_s,
        cpu_s=cpu_s,
        close_s=close_s,
        memory_mb=peak.mb - own_mb,
        base_mb=base_mb,
        append_p50_ms=float(p50),
        append_p99_ms=float(p99),
        append_max_ms=float(append.max()) * 1e3,
        late_p99_ms=float(np.percentile(late, 99)) * 1e3 if paced else None,
        late_max_ms=float(late.max()) * 1e3 if paced else None,
        stored_bytes=size_of(path),
    )


def _check(work: Work, frames: NDArray[np.uint16], writer: Writer) -> None:
    for line in sorted({0, work.lines // 2, work.lines - 1}):
        if not np.array_equal(writer.read(line), frames[line % len(frames)]):
            raise ValueError(f"line {line} was stored otherwise than it was given")


def size_of(path: Path) -> int:
    """Bytes of all files in a folder."""
    return sum(file.stat().st_size for file in path.rglob("*") if file.is_file())


def memory_mb() -> float:
    """Anonymous memory of this process, and shared memory that it maps, which the former does not count."""
    fields = dict(line.split(":") for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines())
    return sum(int(fields[name].split()[0]) for name in ("RssAnon", "RssShmem")) * 1024 / 1e6


class Peak:
    """Watches the memory of this process from a thread."""

    def __init__(self) -> None:
        self.mb = memory_mb()
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: type[BaseException] | BaseException | TracebackType | None) -> None:
        self._done.set()
        self._thread.join()

    def _watch(self) -> None:
        while not self._done.wait(_SAMPLE_S):
            self.mb = max(self.mb, memory_mb())
