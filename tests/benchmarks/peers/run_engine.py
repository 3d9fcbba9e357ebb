"""bluesky: ``bp.scan`` by its RunEngine, over ophyd-async devices on soft signals, without callbacks that print or plot."""

from __future__ import annotations

import asyncio
from collections.abc import Generator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bluesky.plans as bp
import numpy as np
from bluesky.protocols import Movable, Triggerable
from bluesky.run_engine import RunEngine
from bluesky.utils import Msg
from ophyd_async.core import (
    AsyncStatus,
    DetectorAcquireLogic,
    DetectorDataLogic,
    StandardDetector,
    StandardReadable,
    StandardReadableFormat,
    StreamResourceDataProvider,
    StreamResourceInfo,
    init_devices,
    soft_signal_r_and_setter,
)
from work import BLOCK, SHAPE, Blocks, Watch, Work, make_frames


class Mirror(StandardReadable, Movable):
    """Is there at once: a readback on a soft signal."""

    def __init__(self, name: str = "") -> None:
        with self.add_children_as_readables(StandardReadableFormat.HINTED_SIGNAL):
            self.readback, self._set_readback = soft_signal_r_and_setter(float)
        super().__init__(name)

    @AsyncStatus.wrap
    async def set(self, value: float) -> None:
        await asyncio.sleep(0)
        self._set_readback(value)


class Counter(StandardReadable, Triggerable):
    """Exposes for no time and counts."""

    def __init__(self, watch: Watch, name: str = "") -> None:
        with self.add_children_as_readables(StandardReadableFormat.HINTED_SIGNAL):
            self.count, self._set_count = soft_signal_r_and_setter(int)
        self._watch, self._exposed = watch, 0
        super().__init__(name)

    @AsyncStatus.wrap
    async def trigger(self) -> None:
        await asyncio.sleep(0)
        self._exposed += 1
        self._set_count(self._exposed)
        self._watch.line_over()


@dataclass
class Expose(DetectorAcquireLogic):
    """Exposes for no time and stores the frame."""

    file: File
    watch: Watch

    async def start_acquiring(self) -> None:
        await asyncio.sleep(0)
        self.watch.line_over()
        self.file.add_next()

    async def wait_for_idle(self) -> None:
        pass

    async def ensure_stopped(self) -> None:
        pass


@dataclass
class Point(DetectorDataLogic):
    """Tells where the frames are, as the documents of a file-writing detector do."""

    file: File

    async def prepare_unbounded(self, datakey_name: str) -> StreamResourceDataProvider:
        dtype = np.dtype(np.uint16).str
        frames = StreamResourceInfo(
            data_key=datakey_name, shape=SHAPE, chunk_shape=(BLOCK, *SHAPE), dtype_numpy=dtype, parameters={}
        )
        return StreamResourceDataProvider(self.file.path.as_uri(), [frames], "application/x-zarr", self.file.written)


class File:
    """The Zarr array, and how many frames are in it."""

    def __init__(self, path: Path, lines: int) -> None:
        self.path = path
        self.blocks = Blocks(path, lines)
        self.written, self._set_written = soft_signal_r_and_setter(int)
        self._frames, self._next = make_frames(), 0

    def add_next(self) -> None:
        self.blocks.add(self._next, self._frames[self._next % len(self._frames)])
        self._next += 1
        self._set_written(self._next)


class Detector(StandardDetector):
    """A detector that writes its own file."""

    def __init__(self, file: File, watch: Watch, name: str = "") -> None:
        self.file_written = file.written
        self.add_detector_logics(Expose(file, watch), Point(file))
        super().__init__(name)


def scan(work: Work, watch: Watch) -> np.ndarray | None:
    engine = RunEngine()
    with init_devices():
        mirror = Mirror()
        counter = Counter(watch)
    with watch.running():
        file, detector = None, counter
        if work.store is not None:
            file = File(work.store, work.lines)
            with init_devices():
                detector = Detector(file, watch)
        engine(bp.scan([detector], mirror, 0, work.lines - 1, work.lines))
    return None if file is None else file.blocks.read()


def scan_by_messages(work: Work, watch: Watch) -> None:
    """The messages of ``bp.scan`` given out by a bare generator: what the plan's own functions cost is left out."""
    engine = RunEngine()
    with init_devices():
        mirror = Mirror()
        counter = Counter(watch)

    def plan() -> Generator[Msg, Any, None]:
        yield Msg("stage", counter)
        yield Msg("open_run")
        for line in range(work.lines):
            yield Msg("checkpoint")
            yield Msg("set", mirror, line, group="set")
            yield Msg("wait", None, group="set")
            yield Msg("trigger", counter, group="trigger")
            yield Msg("wait", None, group="trigger")
            yield Msg("create", name="primary")
            yield Msg("read", mirror)
            yield Msg("read", counter)
            yield Msg("save")
        yield Msg("close_run")
        yield Msg("unstage", counter)

    with watch.running():
        engine(plan())


def scan_without_engine(work: Work, watch: Watch) -> None:
    """The same devices, asked directly: what the device layer costs alone. Nothing is stored."""
    engine = RunEngine()  # its loop is where the devices live
    with init_devices():
        mirror = Mirror()
        counter = Counter(watch)

    async def step() -> None:
        await counter.stage()
        for line in range(work.lines):
            await mirror.set(line)
            await counter.trigger()
            await asyncio.gather(mirror.read(), counter.read())
        await counter.unstage()

    with watch.running():
        asyncio.run_coroutine_threadsafe(step(), engine.loop).result()
