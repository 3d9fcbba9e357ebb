"""What makes an instrument safe: mirror still, camera disarmed, and on the way out of a scan light off."""

from __future__ import annotations

from functools import partial

from scanhsi.engine.cleanup import CleanupStep
from scanhsi.engine.deadlines import STOP_S, Part
from scanhsi.engine.light import lights_off
from scanhsi.engine.scan import Scan


def make_safe(scan: Scan) -> list[CleanupStep]:
    """Between two legs: mirror and camera at once."""
    watch = scan.watch
    return [
        CleanupStep(
            "stop the mirror",
            scan.actuator.stop,
            STOP_S,
            device=watch.names[Part.ACTUATOR],
            unsafe="the mirror may be moving",
            failed=partial(watch.blame, Part.ACTUATOR),
        ),
        CleanupStep(
            "disarm the camera",
            scan.camera.disarm,
            STOP_S,
            device=watch.names[Part.CAMERA],
            failed=partial(watch.blame, Part.CAMERA),
        ),
    ]


def leave_safe(scan: Scan) -> list[CleanupStep]:
    """At the end: what stays on between two legs goes off, too."""
    return [*make_safe(scan), *lights_off(scan)]
