"""A stepper bench beside tests that run one loop for each use of the device."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager

from scanhsi_sim.twins.stepper import StepperTwin, StepperTwinSettings
from support.twins import Loop


@contextmanager
def bench_in_thread(settings: StepperTwinSettings) -> Generator[StepperTwin]:
    """A running bench."""
    loop, twin = Loop(), StepperTwin(settings)
    try:
        loop.run(twin.__aenter__())
        yield twin
        loop.run(twin.__aexit__(None, None, None))
    finally:
        loop.close()
