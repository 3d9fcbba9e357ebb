"""Rows of the specification sheet that are set, not measured: they come from the instrument file, and say so."""

from __future__ import annotations

from scanhsi.characterise.spec_row import Row
from scanhsi.instrument import InstrumentConfig


def instrument_rows(config: InstrumentConfig) -> list[Row]:
    """What an instrument file says."""
    source = f"instrument file {config.name}, not measured"
    rows = [Row("steps", "", f"{config.geometry.steps_per_revolution}", source=source)]
    if (exposure := config.limits.exposure_s) is not None:
        rows.append(Row("exposure range", "", f"{1000 * exposure[0]:g}-{1000 * exposure[1]:g} ms", source=source))
    if (gain := config.limits.gain_db) is not None:
        rows.append(Row("gain", "", f"{gain[0]:g}-{gain[1]:g} dB", source=source))
    return rows
