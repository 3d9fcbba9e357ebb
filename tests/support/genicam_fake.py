"""The fake camera of viva-genicam as a process of its own: what stays open here is then the driver's.

Commands on stdin, one answer each on stdout: ``triggers``, ``revoke``.
"""

from __future__ import annotations

import os
import subprocess
import sys
from ast import literal_eval


class FakeCamera:
    """A running fake at 127.0.0.1. `dropped`: (block, packet) pairs that it never sends."""

    def __init__(self, dropped: list[tuple[int, int]] | None = None) -> None:
        from scanhsi_sim.twins.netns import require_private_network  # here: the process of the fake shall start quickly

        require_private_network()
        self.process = subprocess.Popen(
            [sys.executable, __file__, repr(dropped or [])], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert self.tell("triggers") == "0"

    def tell(self, command: str) -> str:
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(command + "\n")
        self.process.stdin.flush()
        return self.process.stdout.readline().strip()

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


def main() -> None:
    from viva_genicam.testing import FakeGigeCamera

    dropped = literal_eval(sys.argv[1])
    fake = FakeGigeCamera(width=640, height=480, fps=120, packet_resend=not dropped, drop_packets=dropped)
    fake.start()
    for command in sys.stdin:
        answer = {"triggers": fake.software_triggers, "revoke": fake.revoke_control}[command.strip()]()
        os.write(1, f"{answer}\n".encode())


if __name__ == "__main__":
    main()
