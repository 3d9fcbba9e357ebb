"""scanhsi: a stepped scan with the engine, the event loop and the cube that its users get."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from work import SHAPE, Watch, Work, make_frames

from scanhsi import clock
from scanhsi.bench.idle_devices import IdleActuator, IdleCamera
from scanhsi.cube.layout import CubeSpec
from scanhsi.cube.reader import open_cube
from scanhsi.cube.sink import DiscardSink
from scanhsi.cube.writer import CubeWriter
from scanhsi.devices import CameraSettings, Exposure, Frame, PixelFormat, Pixels
from scanhsi.engine import Course, Mode, run_scan


class Camera(IdleCamera):
    """The idle camera, with pixels where they are asked for."""

    def __init__(self, watch: Watch) -> None:
        super().__init__()
        self.info = replace(self.info, bands=SHAPE[0], samples=SHAPE[1], pixel_formats=(PixelFormat.MONO12,))
        self._watch = watch
        self._frames = make_frames()

    async def expose(self) -> Exposure:
        exposure = await super().expose()
        self._watch.line_over()
        return exposure

    async def unpack(self, frame: Frame, out: Pixels | None) -> None:
        if out is not None:
            np.copyto(out, self._frames[frame.index % len(self._frames)])


def scan(work: Work, watch: Watch) -> np.ndarray | None:
    return _scan(work, watch, "none")


def scan_compressed(work: Work, watch: Watch) -> np.ndarray | None:
    return _scan(work, watch, "lz4")


def _scan(work: Work, watch: Watch, codec: str) -> np.ndarray | None:
    settings = CameraSettings(0.0, 0.0, PixelFormat.MONO12)
    steps = np.arange(work.lines, dtype=np.int64)
    course = Course(Mode.STEPPED, settings, steps, np.zeros(work.lines))
    camera, actuator = Camera(watch), IdleActuator()
    with watch.running():
        if work.store is None:
            sink = DiscardSink()
        else:
            sink = CubeWriter(work.store, CubeSpec(work.lines, *SHAPE, np.uint16, 12), codec=codec)
        clock.run(run_scan(course, camera, actuator, sink))
    if work.store is None:
        return None
    return open_cube(work.store)["cube"].transpose("line", "band", "sample").to_numpy()
