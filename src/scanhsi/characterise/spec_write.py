"""Writes a specification sheet: Markdown to read, JSON for programs, PDF to print."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Final

from matplotlib.backends.backend_pdf import FigureCanvasPdf
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from scanhsi.characterise.spec import NOT_MEASURED, Sheet
from scanhsi.characterise.spec_rows import Row
from scanhsi.devices.errors import ConfigError

LOUD: Final = "SIMULATED: no instrument was measured."
_COLUMNS: Final = ("Specification", "Value", "Standard error", "From", "Paper")


def write_sheet(sheet: Sheet, path: str | Path) -> None:
    """Write a sheet; the ending of the name, ``.md``, ``.json`` or ``.pdf``, says how.

    Raises:
        ConfigError: Another ending, or the file cannot be written.
    """
    path = Path(path)
    try:
        if path.suffix == ".md":
            path.write_text(to_markdown(sheet), encoding="utf-8")
        elif path.suffix == ".json":
            path.write_text(json.dumps(asdict(sheet), indent=2, allow_nan=False) + "\n", encoding="utf-8")
        elif path.suffix == ".pdf":
            _write_pdf(sheet, path)
        else:
            raise ConfigError(f"{path}: a sheet is written as .md, .json or .pdf.")
    except OSError as error:
        raise ConfigError(f"cannot write {path}: {error.strerror or error}.") from error


def to_markdown(sheet: Sheet) -> str:
    """The sheet as Markdown."""
    loud = [f"> **{LOUD}**", ""] if sheet.simulated else []
    return "\n".join(
        [
            f"# Specifications of {sheet.name}",
            "",
            *loud,
            *_table(sheet.table, paper=True),
            "",
            *(["## Further characteristics", "", *_table(sheet.further, paper=False), ""] if sheet.further else []),
            f"Made {sheet.created} by scanhsi {sheet.version}. Rows and their order: Table 7 of *Sensors* 2019, 19(7), 1692.",
            "",
        ]
    )


def _table(rows: Sequence[Row], *, paper: bool) -> list[str]:
    columns = _COLUMNS if paper else _COLUMNS[:-1]
    head = [f"| {' | '.join(columns)} |", f"|{'---|' * len(columns)}"]
    return head + [f"| {' | '.join(_cells(row)[: len(columns)])} |" for row in rows]


def _cells(row: Row) -> list[str]:
    value = f"*{NOT_MEASURED}*" if row.value == NOT_MEASURED else row.value
    return [row.title, value, row.uncertainty, _origin(row), row.paper]


def _origin(row: Row) -> str:
    told = ", ".join(part for part in (Path(row.source).name if row.source else "", row.taken[:10]) if part)
    return f"{told} (simulated)" if row.simulated else told


def _write_pdf(sheet: Sheet, path: Path) -> None:
    figure = Figure(figsize=(8.27, 11.69))  # A4
    FigureCanvasPdf(figure)
    top = _heading(figure, sheet)
    top = _draw_rows(figure, sheet.table, top, paper=True)
    if sheet.further:
        figure.text(0.07, top - 0.018, "Further characteristics", fontsize=10, fontweight="bold", va="top")
        top = _draw_rows(figure, sheet.further, top - 0.045, paper=False)
    figure.text(0.07, 0.03, f"Made {sheet.created} by scanhsi {sheet.version}.", fontsize=6.5, color="0.4")
    figure.savefig(path, metadata={"Title": f"Specifications of {sheet.name}"})


def _heading(figure: Figure, sheet: Sheet) -> float:
    figure.text(0.07, 0.95, f"Specifications of {sheet.name}", fontsize=14, fontweight="bold", va="top")
    if not sheet.simulated:
        return 0.915
    box = {"facecolor": "#C1272D", "edgecolor": "none", "pad": 4}
    figure.text(0.075, 0.915, LOUD, fontsize=10, fontweight="bold", color="white", va="top", bbox=box)
    return 0.88


_WIDTHS: Final = (30, 40, 18, 30, 22)
_PLACES: Final = (0.07, 0.285, 0.545, 0.665, 0.845)
_LINE: Final = 0.0118


def _draw_rows(figure: Figure, rows: Sequence[Row], top: float, *, paper: bool) -> float:
    count = 5 if paper else 4
    for place, title in zip(_PLACES[:count], _COLUMNS, strict=False):
        figure.text(place, top, title, fontsize=7.5, fontweight="bold", va="top")
    top -= 0.016
    for row in rows:
        figure.add_artist(Line2D([0.07, 0.97], [top + 0.002, top + 0.002], color="0.85", linewidth=0.5))
        cells = [row.title, row.value, row.uncertainty, _origin(row), row.paper][:count]
        wrapped = [textwrap.wrap(cell, width) or [""] for cell, width in zip(cells, _WIDTHS, strict=False)]
        colour = "0.5" if row.value == NOT_MEASURED else "black"
        for place, lines in zip(_PLACES, wrapped, strict=False):
            figure.text(place, top - 0.001, "\n".join(lines), fontsize=7, va="top", color=colour, linespacing=1.15)
        top -= _LINE * max(map(len, wrapped)) + 0.004
    return top
