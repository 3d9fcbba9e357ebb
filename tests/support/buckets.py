"""Cubes in buckets: writers that are killed there, and what they left."""

from __future__ import annotations

import os
import select
import shutil
import signal
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from scanhsi.cube.location import locate
from scanhsi.cube.objects import Objects
from support.seaweed import S3
from support.victims import End, Job, Victims


def cube_copy(server: S3, url: str, here: Path) -> Path | None:
    """A copy of what is in the bucket; None where that is no cube."""
    shutil.rmtree(here, ignore_errors=True)
    if "zarr.json" not in server.contents(url):
        return None
    server.download(url, here)
    return here


def kill_after(victims: Victims, job: Job, moment: str | Callable[[], bool], delay_s: float) -> End:
    """Kill a writer so much later than a key has appeared, or something is true; a writer that is done is not killed."""
    objects = Objects(locate(job.path))
    has_come = moment if callable(moment) else lambda: objects.version(moment) is not None
    victim = os.pidfd_open(victims.start(job))
    try:
        victims.go()
        while not select.select([victim], [], [], 0.003)[0] and not has_come():
            pass
        time.sleep(delay_s)
        with suppress(ProcessLookupError):
            signal.pidfd_send_signal(victim, signal.SIGKILL)
    finally:
        os.close(victim)
    return victims.end()
