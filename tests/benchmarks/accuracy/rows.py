"""A row of the table, and how an acquisition of the simulated instrument is made for it."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

import scanhsi
from scanhsi.clock import run_virtual
from scanhsi.imager import Imager
from scanhsi.instrument import InstrumentConfig, load_instrument
from scanhsi_sim import ActuatorOptions, CameraOptions, Truth, truth

R = TypeVar("R")


@dataclass(frozen=True, slots=True)
class Row:
    """One number.

    Attributes:
        what: Which.
        asked: What the paper, the standard or the issue asks for; empty where nobody asks.
        reached: What came out.
        good: Whether that is enough.
    """

    what: str
    asked: str
    reached: str
    good: bool = True


def acquire(
    settings: dict[str, object], protocol: Callable[[Imager], Awaitable[R]], instrument: str = "characterise"
) -> tuple[R, Truth, InstrumentConfig]:
    """Open a simulated instrument in virtual time, run a protocol on it; the result, the truth, and what the instrument was."""
    config = load_instrument(instrument, settings)

    async def main() -> R:
        async with scanhsi.open_instrument(config) as hsi:
            return await protocol(hsi)

    return run_virtual(main()), truth_of(config), config


def truth_of(config: InstrumentConfig) -> Truth:
    camera, actuator = config.camera.options, config.actuator.options
    assert isinstance(camera, CameraOptions)
    assert isinstance(actuator, ActuatorOptions)
    return truth(camera, actuator)


def region(config: InstrumentConfig) -> tuple[slice, slice]:
    """Where on the sensor the region lies, (band, sample)."""
    roi = config.roi
    assert roi is not None
    return (
        slice(roi.band_offset, roi.band_offset + roi.bands),
        slice(roi.sample_offset, roi.sample_offset + roi.samples),
    )


def rms(values: object) -> float:
    return float(np.sqrt(np.mean(np.square(np.asarray(values, float)))))


def markdown(rows: list[Row]) -> str:
    lines = ["| | asked for | reached |", "| --- | --- | --- |"]
    lines += [f"| {row.what} | {row.asked} | {row.reached}{'' if row.good else ' **not met**'} |" for row in rows]
    return "\n".join(lines)
