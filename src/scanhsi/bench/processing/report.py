"""Observations to Markdown."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from scanhsi.bench.processing.session import Record
from scanhsi.bench.processing.work import FULL_RATE

_NOTES: Final = {
    "copy lines": "the raw lines, in memory",
    "chain": "mask, dark, white, cubic smile, bins of five: in one pass",
    "chain, some saturated": "the same with saturated pixels in every line",
    "step by step": "the same steps one after the other",
    "openhsi, level 4": "OpenHSI: crop, smile by whole pixels, sums of five, dark, one factor; no mask",
    "openhsi, level 6": "the same, divided by a spectrum",
    "copy file": "raw pixels from disk to disk, synced",
    "rewrite": "raw cube read and written again, two threads, nothing computed",
    "process, 1 thread": "raw cube to reflectance cube",
    "process, 2 threads": "raw cube to reflectance cube",
    "store": "the raw cube alone",
    "store and process": "and the reflectance cube beside it, by another process on the same core",
}


def markdown(records: list[Record]) -> str:
    """Tables of a session."""
    facts, size = records[0], records[0]["size"]
    machine, git = facts["machine"], facts["git"]
    source = "unknown source" if git is None else f"{git['commit'][:9]}{' and changes' if git['changed'] else ''}"
    parts = [
        f"{facts['started']}, {machine['processor']}, {machine['cpus']} processors, {machine['system']} "
        f"{machine['kernel']}, load {facts['load'][0]:.1f} before; scanhsi {source}. "
        f"Lines of {size['bands']} x {size['samples']} u16. Best of the repetitions (median, most).",
        "",
    ]
    raw_mb = 2 * size["bands"] * size["samples"] / 1e6
    tables = (
        ("memory", "In memory, one core", _memory),
        ("disk", f"From disk to disk, {size['lines']} lines", _disk),
        ("live", f"Lines as they come, {FULL_RATE:g} a second, one core for all", _live),
    )
    for part, title, table in tables:
        rows = _rows(records, part)
        if rows:
            parts += [f"### {title}", "", *table(rows, raw_mb, size["lines"]), ""]
    return "\n".join(parts).strip()


def _rows(records: list[Record], part: str) -> dict[str, list[Record]]:
    found: dict[str, list[Record]] = {}
    for seen in records:
        if seen["record"] == "row" and seen["part"] == part:
            found.setdefault(seen["row"], []).append(seen)
    return found


def _memory(rows: dict[str, list[Record]], raw_mb: float, _: int) -> Iterator[str]:
    yield "| | ms a line | lines/s | MB/s raw | times ours | |"
    yield "|---|---|---|---|---|---|"
    ours = _best(rows.get("chain", []), "ms_a_line")
    for name, runs in rows.items():
        if (told := _error(name, runs, 5)) is not None:
            yield told
            continue
        ms = _best(runs, "ms_a_line")
        cells = (_spread(runs, "ms_a_line", ".2f"), f"{1e3 / ms:.0f}", f"{1e3 * raw_mb / ms:.0f}", f"{ms / ours:.2f}")
        yield f"| {name} | {' | '.join(cells)} | {_NOTES[name]} |"


def _disk(rows: dict[str, list[Record]], raw_mb: float, lines: int) -> Iterator[str]:
    yield "| | s | MB/s raw | of the copy | CPU s/GB | peak MB | |"
    yield "|---|---|---|---|---|---|---|"
    copy = _best(rows.get("copy file", []), "wall_s")
    for name, runs in rows.items():
        if (told := _error(name, runs, 6)) is not None:
            yield told
            continue
        wall, total = _best(runs, "wall_s"), raw_mb * lines
        cells = (
            _spread(runs, "wall_s", ".2f"),
            f"{total / wall:.0f}",
            f"{copy / wall:.2f}",
            f"{_best(runs, 'cpu_s') / total * 1e3:.2f}",
            f"{max(seen['peak_mb'] for seen in runs):.0f}",
        )
        yield f"| {name} | {' | '.join(cells)} | {_NOTES[name]} |"


def _live(rows: dict[str, list[Record]], _: float, _lines: int) -> Iterator[str]:
    yield f"| | CPU ms a line, of {1e3 / FULL_RATE:.1f} | late p99 ms | late max ms | lines behind at the end | caught up in s | |"
    yield "|---|---|---|---|---|---|---|"
    for name, runs in rows.items():
        if (told := _error(name, runs, 6)) is not None:
            yield told
            continue
        live = "behind" in runs[0]
        cells = (
            f"{1e3 * _best(runs, 'cpu_s') / runs[0]['of_lines']:.1f}",
            _spread(runs, "late_p99_ms", ".1f"),
            _spread(runs, "late_max_ms", ".1f"),
            _spread(runs, "behind", ".0f") if live else "–",
            _spread(runs, "caught_up_s", ".2f") if live else "–",
        )
        yield f"| {name} | {' | '.join(cells)} | {_NOTES[name]} |"


def _error(name: str, runs: list[Record], columns: int) -> str | None:
    why = next((seen["error"] for seen in runs if seen.get("error")), None)
    return None if why is None else f"| {name} |{' – |' * (columns - 1)} did not run here: {why.replace('|', '/')} |"


def _best(runs: list[Record], name: str) -> float:
    return min((seen[name] for seen in runs if name in seen), default=float("nan"))


def _spread(runs: list[Record], name: str, form: str) -> str:
    values = [seen[name] for seen in runs]
    return f"{min(values):{form}} ({float(np.median(values)):{form}}, {max(values):{form}})"
