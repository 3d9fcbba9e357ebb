"""Targets that a person has to change: asked for at a terminal (a real one, of the kernel), answered with Enter or with Ctrl-C."""

from __future__ import annotations

import fcntl
import os
import select
import subprocess
import sys
import termios
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from scanhsi.calibration.result import load
from scanhsi.calibration.white import WhiteReference

# A camera that cannot be told what to look at: it sees what somebody has put before it, which is written in a file.
BLIND = """
from pathlib import Path

from pydantic import Field

from scanhsi.devices import Backend
from scanhsi_sim.camera import create_camera
from scanhsi_sim.options import CameraOptions


class BlindOptions(CameraOptions):
    before: Path = Field(description="file that holds the name of what is before it")


class BlindCamera:
    def __init__(self, options):
        self._before = options.before
        self._camera = create_camera(options)

    async def arm(self, trigger, buffers):
        await self._camera.show(self._before.read_text().strip())
        await self._camera.arm(trigger, buffers)

    def __getattr__(self, name):
        if name in ("show", "scene", "scenes"):
            raise AttributeError(name)
        return getattr(self._camera, name)


backend = Backend("Blind", BlindOptions, BlindCamera, BlindCamera)
"""
INSTRUMENT = """
[camera]
driver = "blind"
before = "{before}"
profile = "ideal"
bands = 30
samples = 40
[actuator]
driver = "simulated"
profile = "ideal"
home_s = 0.0
[geometry]
distance = "350 mm"
normal_step = 0
[scan]
lines = 4
exposure = "20 ms"
"""
SECONDS = 90.0


@dataclass
class Terminal:
    """A program at a terminal of its own."""

    process: subprocess.Popen[bytes]
    screen: int
    shown: str = field(default="")

    def read_until(self, text: str) -> None:
        """Read what is shown until a text is."""
        deadline = time.monotonic() + SECONDS
        while text not in self.shown:
            ready, _, _ = select.select([self.screen], [], [], max(0.0, deadline - time.monotonic()))
            assert ready, f"{text!r} was not shown: {self.shown}"
            try:
                self.shown += os.read(self.screen, 4096).decode()
            except OSError:  # the program has ended
                raise AssertionError(f"{text!r} was not shown: {self.shown}") from None
        self.shown = self.shown.split(text, 1)[1]

    def press(self, key: bytes) -> None:
        os.write(self.screen, key)

    def end(self) -> int:
        """Wait for its end, reading on; its exit code."""
        try:
            while data := os.read(self.screen, 4096):
                self.shown += data.decode()
        except OSError:
            pass
        return self.process.wait(SECONDS)


def _own_terminal() -> None:
    fcntl.ioctl(0, termios.TIOCSCTTY, 0)


@pytest.fixture
def terminal(tmp_path: Path) -> Iterator[Terminal]:
    (tmp_path / "blind_camera.py").write_text(BLIND)
    about = tmp_path / "blind-0.1.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: blind\nVersion: 0.1\n")
    (about / "entry_points.txt").write_text("[scanhsi.cameras]\nblind = blind_camera:backend\n")
    (tmp_path / "before.txt").write_text("hand")
    (tmp_path / "blind.toml").write_text(INSTRUMENT.format(before=tmp_path / "before.txt"))
    screen, keyboard = os.openpty()
    words = [
        "calibrate",
        "white",
        "blind.toml",
        "-o",
        "white.nc",
        "--exposure",
        "20 ms",
        "--frames",
        "3",
        "--no-figure",
    ]
    path = os.pathsep.join([str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])])
    process = subprocess.Popen(
        [sys.executable, "-m", "scanhsi", *words],
        cwd=tmp_path,
        stdin=keyboard,
        stdout=keyboard,
        stderr=keyboard,
        env={**os.environ, "PYTHONPATH": path, "COLUMNS": "200"},
        start_new_session=True,
        preexec_fn=_own_terminal,
    )
    os.close(keyboard)
    yield Terminal(process, screen)
    process.kill()
    process.wait()
    os.close(screen)


def test_each_target_is_asked_for_and_waited_for(terminal: Terminal, tmp_path: Path) -> None:
    for request, scene, keys in (("Put the white tile", "white", b"\n\n"), ("Close the shutter", "dark", b"\n")):
        terminal.read_until(request)
        terminal.read_until("press Enter.")
        time.sleep(0.5)  # a person takes some time: long enough for a program that does not wait to go on
        (tmp_path / "before.txt").write_text(scene)
        terminal.press(keys)  # twice is no answer to the next one
    assert terminal.end() == 0, terminal.shown
    white = load(WhiteReference, tmp_path / "white.nc")
    assert (white.mean - white.dark).mean() > 100  # it saw the tile, and then the shutter


def test_ctrl_c_at_a_prompt_ends_it_without_a_result(terminal: Terminal, tmp_path: Path) -> None:
    terminal.read_until("press Enter.")
    terminal.press(b"\x03")
    assert terminal.end() == 130, terminal.shown
    assert "Traceback" not in terminal.shown
    assert not (tmp_path / "white.nc").exists()
