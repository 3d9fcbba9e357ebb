"""``scanhsi serve`` in a process of its own, small and quick to start."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

SMALL = ("roi.samples=64", "roi.bands=48", "roi.sample_offset=1000", "roi.band_offset=500")


@dataclass
class Server:
    """A server that runs.

    Attributes:
        url: Where it listens.
        process: It.
        said: What it wrote.
    """

    url: str
    process: subprocess.Popen[str]
    said: list[str] = field(default_factory=list[str])

    def end(self, number: int = signal.SIGTERM) -> int:
        """Send a signal; return the exit code."""
        self.process.send_signal(number)
        return self.process.wait(30)


@contextmanager
def serving(
    data: Path,
    *settings: str,
    token: str | None = None,
    arguments: tuple[str, ...] = (),
    variables: Mapping[str, str] | None = None,
) -> Generator[Server]:
    """A server on a free port; killed on leaving."""
    words = [word for setting in settings or SMALL for word in ("--set", setting)]
    command = [sys.executable, "-m", "scanhsi", "serve", "sensors2019", "--data", str(data), "--port", "0", *words]
    secret = {} if token is None else {"SCANHSI_TOKEN": token}
    environment = {**os.environ, "COLUMNS": "200", **secret, **(variables or {})}
    process = subprocess.Popen([*command, *arguments], stderr=subprocess.PIPE, text=True, env=environment)
    assert process.stderr is not None
    said: list[str] = []
    reader: threading.Thread | None = None
    try:
        for line in process.stderr:
            said.append(line)
            if found := re.search(r"listening on (\S+)", line):
                reader = threading.Thread(target=said.extend, args=(process.stderr,), daemon=True)
                reader.start()
                yield Server(found[1], process, said)
                break
        else:
            raise AssertionError(f"the server ended: {''.join(said)}")
    finally:
        if process.poll() is None:
            process.kill()
        process.wait()
        if reader is not None:
            reader.join()
        process.stderr.close()
