"""Invariants of the engine that other files do not test, each also with something broken on purpose, to show that it is seen."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable
from typing import Any

import numpy as np
import pytest

from scanhsi.clock import VirtualDeadlock, run_virtual
from scanhsi.cube.records import NOT_STAMPED, LineStatus
from scanhsi.devices import CameraSettings, PixelFormat
from scanhsi.devices.errors import DeviceTimeout, DeviceUnsafe, ScanFailed
from scanhsi.engine import Course, Mode, ScanReport, run_scan
from scanhsi.engine.scan import Credits
from support.bench import Bench, BenchActuator, BenchCamera, MemorySink

LINES = 30


def course(mode: Mode) -> Course:
    steps = np.arange(LINES, dtype=np.int64)
    return Course(mode, CameraSettings(0.02, 0.0, PixelFormat.MONO12), steps, steps * 0.1)


async def scan(
    mode: Mode, bench: Bench, sink: MemorySink, camera: Any = BenchCamera, actuator: Any = BenchActuator
) -> ScanReport:
    return await run_scan(course(mode), camera(bench), actuator(bench), sink)


# --- 2: each line ends as stored or as missing; nothing is stored twice ---------------------------------------------------


@pytest.mark.parametrize("mode", Mode)
def test_each_line_ends_once(mode: Mode) -> None:
    bench, sink = (
        Bench(lose=frozenset({3, 17}), swallow=frozenset({9} if mode is not Mode.CONTINUOUS else ())),
        MemorySink(),
    )
    report = run_virtual(scan(mode, bench, sink))
    assert report.stored + report.missing == LINES
    assert np.all(sink.records.status != LineStatus.NOT_STORED)


def test_a_driver_that_swallows_a_frame_and_numbers_on_would_be_caught() -> None:
    """The check of the pixels has teeth: after a frame that nobody misses, lines hold another line's pixels."""

    class Renumbering(BenchCamera):
        """Numbers the frames that arrive instead of the exposures."""

        def _put(self, index: int, start: int, when: int, position: int) -> None:
            if index != 9:
                super()._put(index - (index > 9), start, when, position)

    sink = MemorySink()
    run_virtual(scan(Mode.STEPPED, Bench(), sink, camera=Renumbering))
    wrong = [line for line, pixels in sink.pixels.items() if np.any(pixels != line)]
    assert wrong == list(range(9, LINES - 1))


# --- 3: memory is bounded by the credits ----------------------------------------------------------------------------------


def test_an_engine_without_credits_would_be_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Credits, "may_expose", lambda self, line: True)
    with pytest.raises(ScanFailed, match="outside the window of credits"):
        run_virtual(scan(Mode.STEPPED, Bench(), MemorySink(capacity=4, store_ms=100)))


# --- 6: every await on a device has a deadline that names what it waited for ------------------------------------------------


async def _for_ever(*_: object) -> Any:
    await asyncio.Event().wait()


@pytest.mark.parametrize(
    ("device", "method", "named", "mode"),
    [
        (BenchCamera, "configure", "configure", Mode.STEPPED),
        (BenchCamera, "arm", "arm", Mode.STEPPED),
        (BenchCamera, "expose", "expose, line 0", Mode.STEPPED),
        (BenchCamera, "unpack", "unpack, line 0", Mode.STEPPED),
        (BenchActuator, "home", "home", Mode.STEPPED),
        (BenchActuator, "move_to", "move_to 0, line 0", Mode.SEQUENTIAL),
        (BenchActuator, "prepare_sweep", "prepare_sweep", Mode.CONTINUOUS),
        (BenchActuator, "sweep", "sweep", Mode.CONTINUOUS),
        (MemorySink, "append", "store, line 0", Mode.STEPPED),
        (MemorySink, "flush", "store", Mode.STEPPED),
        (BenchActuator, "stop", "stop the mirror", Mode.STEPPED),
        (BenchCamera, "disarm", "disarm the camera", Mode.STEPPED),
        (MemorySink, "close", "close the cube", Mode.STEPPED),
    ],
)
def test_nothing_hangs(device: type, method: str, named: str, mode: Mode, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(device, method, _for_ever)
    bench, sink = Bench(homed=method != "home"), MemorySink(batch=1000 if method == "flush" else 1, capacity=100)
    with pytest.raises((ScanFailed, DeviceTimeout), match=named) as failed:
        run_virtual(scan(mode, bench, sink))
    causes = failed.value.causes if isinstance(failed.value, ScanFailed) else (failed.value,)
    assert any(isinstance(cause, DeviceTimeout | DeviceUnsafe) and cause.waited_s for cause in causes)
    assert sink.closed or method in ("configure", "close")


def test_an_engine_without_deadlines_would_be_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    """Virtual time tells a wait that nothing can end."""

    class Patient:
        def __init__(self, *_: object, **__: object) -> None: ...

        async def __aenter__(self) -> None: ...

        async def __aexit__(self, *_: object) -> None: ...

    monkeypatch.setattr("scanhsi.engine.deadlines.Deadline", Patient)
    monkeypatch.setattr(BenchCamera, "expose", _for_ever)
    with pytest.raises(VirtualDeadlock):
        run_virtual(scan(Mode.STEPPED, Bench(), MemorySink()))


# --- 7: stamps in preallocated arrays; nothing per line in the log ---------------------------------------------------------


@pytest.mark.parametrize("mode", Mode)
def test_nothing_is_logged_per_line(mode: Mode, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.INFO):
        run_virtual(scan(mode, Bench(lose=frozenset({2})), MemorySink()))
    assert len(caplog.records) < LINES / 3


def test_columns_of_the_records_are_written_in_place() -> None:
    sink = MemorySink()
    opened: dict[str, Any] = {}
    original: Callable[..., Awaitable[None]] = sink.open

    async def open_and_look(records: Any) -> None:
        opened.update(records.stamps)
        await original(records)

    sink.open = open_and_look  # type: ignore[method-assign]
    run_virtual(scan(Mode.STEPPED, Bench(), sink))
    for stage, column in opened.items():
        assert sink.records.stamps[stage] is column
        assert column.dtype == np.int64
        taken = column[1:] if stage in ("commanded", "started", "moved") else column
        assert np.all(taken != NOT_STAMPED), stage
