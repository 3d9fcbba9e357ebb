"""Rows of the specification sheet, from each kind of result, and from the bench."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from scanhsi.calibration.result import Result, identity
from scanhsi.characterise import spec_mirror_rows, spec_optics_rows, spec_sensor_rows
from scanhsi.characterise.spec_row import Row, Timing, shown

_ROWS: Final = {**spec_sensor_rows.ROWS, **spec_optics_rows.ROWS, **spec_mirror_rows.ROWS}


def result_rows(result: Result, source: str) -> list[Row]:
    """Rows of a result.

    Args:
        result: Of any kind; one that the sheet has no row for gives none.
        source: Its file.
    """
    provenance, own = result.provenance, identity(result)

    def make(key: str, title: str, number: float, unit: str, sigma: float = math.nan, text: str = "") -> Row:
        return Row(
            key,
            title,
            text or shown(number, unit, sigma),
            uncertainty=shown(sigma, unit, sigma) if math.isfinite(sigma) else "",
            number=number if math.isfinite(number) else None,
            unit=unit,
            source=source,
            identity=own,
            taken=provenance.taken or provenance.created,
            simulated=provenance.simulated,
        )

    rows = _ROWS.get(result.kind)
    return [] if rows is None else rows(result, make)


def timing_rows(timings: Sequence[Timing]) -> list[Row]:
    """Rows of efficiencies; Table 7 has that of 8 bit and 100 ms in the mode of the paper, everything in turn."""
    rows: list[Row] = []
    for timing in timings:
        said = f"{timing.pixel_format}, {1000 * timing.exposure_s:g} ms"
        papers = timing.pixel_format == "Mono8" and math.isclose(timing.exposure_s, 0.1)
        key = "efficiency" if papers and timing.mode == "sequential" else f"efficiency {timing.mode} {said}"
        rows.append(
            Row(
                key,
                f"Efficiency, {timing.mode}, {said}",
                f"{100 * timing.efficiency:.1f} %",
                uncertainty=f"{100 * timing.sigma:.1g} %",
                number=timing.efficiency,
                unit="1",
                source=timing.source,
                taken=timing.taken,
                simulated=timing.simulated,
            )
        )
    return rows
