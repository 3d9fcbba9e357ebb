"""Writes a specification sheet: Markdown to read, JSON for programs, PDF to print."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from scanhsi.characterise.spec import NOT_MEASURED, Sheet
from scanhsi.characterise.spec_row import Row
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
            *_table(sheet, sheet.table, paper=True),
            "",
            *(
                ["## Further characteristics", "", *_table(sheet, sheet.further, paper=False), ""]
                if sheet.further
                else []
            ),
            f"Made {sheet.created} by scanhsi {sheet.version}. Rows and their order: Table 7 of *Sensors* 2019, 19(7), 1692.",
            "",
        ]
    )


def _table(sheet: Sheet, rows: Sequence[Row], *, paper: bool) -> list[str]:
    columns = _COLUMNS if paper else _COLUMNS[:-1]
    head = [f"| {' | '.join(columns)} |", f"|{'---|' * len(columns)}"]
    return head + [f"| {' | '.join(_cells(sheet, row)[: len(columns)])} |" for row in rows]


def _cells(sheet: Sheet, row: Row) -> list[str]:
    value = f"*{NOT_MEASURED}*" if row.value == NOT_MEASURED else row.value
    return [row.title, value, row.uncertainty, _origin(sheet, row), row.paper]


def _origin(sheet: Sheet, row: Row) -> str:
    """File, identity and date of the result; that it is simulated only where not all is, as the head says."""
    name = f"{Path(row.source).name if row.source else ''} {row.identity}".strip()
    told = ", ".join(part for part in (name, row.taken[:10]) if part)
    return f"{told} (simulated)" if row.simulated and not sheet.all_simulated else told


def _write_pdf(sheet: Sheet, path: Path) -> None:
    with PdfPages(path, metadata={"Title": f"Specifications of {sheet.name}"}) as pages:
        for figure in draw_pages(sheet):
            pages.savefig(figure)


def draw_pages(sheet: Sheet) -> list[Figure]:
    """The sheet as pages of A4."""
    page = _Page(sheet)
    page.rows(sheet.table, paper=True)
    if sheet.further:
        page.heading("Further characteristics")
        page.rows(sheet.further, paper=False)
    return page.figures


_WITH_PAPER: Final = ((0.07, 0.275, 0.52, 0.635, 0.845), (28, 32, 15, 29, 18))
_WITHOUT_PAPER: Final = ((0.07, 0.36, 0.585, 0.692), (43, 33, 15, 40))
"""Where columns begin, as shares of the page, and how many characters they take."""

_LINE: Final = 0.0118
_BOTTOM: Final = 0.055


class _Page:
    """Puts rows on pages, from above, and begins a new page where one is full."""

    def __init__(self, sheet: Sheet) -> None:
        self._sheet = sheet
        self.figures: list[Figure] = []
        self._begin()

    def _begin(self) -> None:
        sheet = self._sheet
        self._figure = Figure(figsize=(8.27, 11.69))  # A4
        FigureCanvasAgg(self._figure)
        self.figures.append(self._figure)
        self._text(0.07, 0.95, f"Specifications of {sheet.name}", fontsize=14, fontweight="bold")
        self._top = 0.915
        if sheet.simulated:
            box = {"facecolor": "#C1272D", "edgecolor": "none", "pad": 4}
            self._text(0.075, self._top, LOUD, fontsize=10, fontweight="bold", color="white", bbox=box)
            self._top -= 0.035
        foot = f"Made {sheet.created} by scanhsi {sheet.version}. Page {len(self.figures)}."
        self._text(0.07, 0.035, foot, fontsize=6.5, color="0.4")

    def heading(self, title: str) -> None:
        """A title within the page."""
        if self._top < _BOTTOM + 0.1:
            self._begin()
        self._text(0.07, self._top - 0.018, title, fontsize=10, fontweight="bold")
        self._top -= 0.045

    def rows(self, rows: Sequence[Row], *, paper: bool) -> None:
        """A table."""
        places, widths = _WITH_PAPER if paper else _WITHOUT_PAPER
        self._columns(places)
        for row in rows:
            cells = [row.title, row.value, row.uncertainty, _origin(self._sheet, row), row.paper][: len(widths)]
            wrapped = [textwrap.wrap(cell, width) or [""] for cell, width in zip(cells, widths, strict=True)]
            height = _LINE * max(map(len, wrapped)) + 0.004
            if self._top - height < _BOTTOM:
                self._begin()
                self._columns(places)
            colour = "0.5" if row.value == NOT_MEASURED else "black"
            rule = Line2D([0.07, 0.97], [self._top + 0.002] * 2, color="0.85", linewidth=0.5)
            self._figure.add_artist(rule)
            for place, lines in zip(places, wrapped, strict=True):
                self._text(place, self._top - 0.001, "\n".join(lines), fontsize=7, color=colour, linespacing=1.15)
            self._top -= height

    def _columns(self, places: Sequence[float]) -> None:
        for place, title in zip(places, _COLUMNS, strict=False):
            self._text(place, self._top, title, fontsize=7.5, fontweight="bold")
        self._top -= 0.016

    def _text(self, x: float, y: float, text: str, **style: Any) -> None:
        self._figure.text(x, y, text, va="top", **style)
