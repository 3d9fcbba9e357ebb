"""Processes that keep a computer busy beside a measurement."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Generator
from contextlib import contextmanager
from typing import Final

_SETTLING_S: Final = 0.3
_HOG: Final = "import os\nparent = os.getppid()\nwhile os.getppid() == parent: pass"


@contextmanager
def busy(hogs: int) -> Generator[None]:
    """So many busy processes while entered; each ends by itself should this one vanish."""
    running = [subprocess.Popen([sys.executable, "-c", _HOG]) for _ in range(hogs)]
    try:
        if running:
            time.sleep(_SETTLING_S)
        yield
    finally:
        for process in running:
            process.kill()
        for process in running:
            process.wait()
