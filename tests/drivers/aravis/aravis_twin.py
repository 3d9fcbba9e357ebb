"""The camera twin as a process of its own."""

import json
import socket
import struct
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

STEP = 137
"""Mirror step that the twin's camera sees."""


class Twin:
    """One running camera twin at 127.0.0.1."""

    def __init__(self, folder: Path) -> None:
        self.address = "127.0.0.1"
        self._trigger = folder / "trigger.sock"
        command = ["--scene", "testpattern", "--step", str(STEP), "--trigger-socket", str(self._trigger)]
        self.process = subprocess.Popen(
            [sys.executable, "-m", "scanhsi_sim.twins.camera", *command],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self._line().startswith("ready")

    def tell(self, command: str) -> str:
        """One line to the twin, one line back."""
        assert self.process.stdin is not None
        self.process.stdin.write(command + "\n")
        self.process.stdin.flush()
        return self._line()

    def stats(self) -> dict[str, int]:
        return json.loads(self.tell("stats"))

    def pulse(self, number: int) -> None:
        """One pulse on the hardware trigger line."""
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as line:
            line.sendto(struct.pack("<qqq", number, STEP, time.monotonic_ns()), str(self._trigger))

    def kill(self) -> None:
        """The camera is unplugged."""
        self.process.kill()
        self.process.wait()

    def close(self) -> None:
        self.kill()
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.close()
        self.process.stdout.close()

    def _line(self) -> str:
        assert self.process.stdout is not None
        return self.process.stdout.readline().strip()


def threads() -> list[str]:
    """Threads of the driver and of Aravis that are alive."""
    names = [thread.name for thread in threading.enumerate() if thread.name.startswith("aravis")]
    for comm in Path("/proc/self/task").glob("*/comm"):
        with suppress(OSError):  # it has just ended
            names += [name for name in [comm.read_text().strip()] if name.startswith("arv_")]
    return names
