"""Observations to Markdown: what each writer and reader took, and which of the targets were met."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Final

import numpy as np

from scanhsi.bench.storage.rows import BY_KEY, FLOOR, ROWS, Coding, Row
from scanhsi.bench.storage.session import Record

Seen = dict[str, dict[int, Record]]
"""Row -> repetition -> what was seen."""

_FLAT_HEAD: Final = (
    "| writer | MB/s, synced | of the floor | times ours | CPU s/GB | memory MB | append p50 / p99 / max ms | ratio | |",
    "|---|---|---|---|---|---|---|---|---|",
)
_PACED_HEAD: Final = (
    "| writer | append p50 ms | p99 ms | max ms | late p99 ms | cores | memory MB | ratio |",
    "|---|---|---|---|---|---|---|---|",
)
_CODINGS: Final[tuple[Coding, ...]] = ("lz4", "zstd", "uncompressed")


def markdown(records: list[Record]) -> str:
    """Tables of a session."""
    flat, paced = _by_row(records, "flat out"), _by_row(records, "paced")
    parts = [heading(records), ""]
    if flat:
        parts += ["### Flat out", "", *_flat_table(flat), ""]
    if paced:
        rate = next(seen["work"]["rate"] for seen in records if seen["record"] == "paced")
        parts += [f"### {rate:g} lines a second ({_paced_mb_s(records):.0f} MB/s)", "", *_paced_table(paced), ""]
    if verdicts := [*_speed_verdicts(flat), *_paced_verdicts(paced)]:
        parts += ["### Targets", "", *(f"* {verdict}" for verdict in verdicts), ""]
    if read := [seen for seen in records if seen["record"] == "read"]:
        parts += _reading(read)
    return "\n".join(parts).strip()


def heading(records: list[Record]) -> str:
    """Where and when."""
    facts = records[0]
    machine, git = facts["machine"], facts["git"]
    source = "unknown source" if git is None else f"{git['commit'][:9]}{' and changes' if git['changed'] else ''}"
    loads = [seen["load"] for seen in records[1:]] or [0.0]
    packages = {**facts["packages"], "Python": facts["versions"]["python"]}
    lines = [
        f"{facts['started']}, {machine['processor']}, {machine['cpus']} processors, {machine['system']} {machine['kernel']}; "
        f"load meanwhile {min(loads):.1f} to {max(loads):.1f}, median {np.median(loads):.1f}, of which the benchmark is some; "
        f"scanhsi {source}.",
        ", ".join(f"{name} {number}" for name, number in sorted(packages.items(), key=lambda item: item[0].lower()))
        + ".",
    ]
    if facts["missing"]:
        needed = ", ".join(sorted({name.replace("_", "-") for name in facts["missing"].values()}))
        lines.append(
            f"Not installed, so not measured: {needed} (`pip install {needed.replace(',', '')}`, or `make bench-storage`)."
        )
    return "\n".join(lines)


def _by_row(records: list[Record], part: str) -> Seen:
    """In the order of the table."""
    found: Seen = {}
    for row in ROWS:
        runs = {seen["repetition"]: seen for seen in records if seen["record"] == part and seen["row"] == row.key}
        if runs:
            found[row.key] = runs
    return found


def _flat_table(flat: Seen) -> Iterator[str]:
    yield from _FLAT_HEAD
    for coding in _CODINGS:
        for key, runs in flat.items():
            if BY_KEY[key].coding == coding:
                yield _flat_line(BY_KEY[key], _good(runs), flat, _error(runs))


def _flat_line(row: Row, runs: list[Record], flat: Seen, error: str | None) -> str:
    if error is not None:
        return f"| {row.name} | – | – | – | – | – | – | – | did not run here: {error} |"
    floor = FLOOR if row.filled else f"{FLOOR}/there"
    cells = (
        _spread([_mb_s(seen) for seen in runs], ".0f"),
        "1" if row.key == floor else _number(_ratio(flat, row.key, floor)),
        "–" if row.beside is None else _number(_ratio(flat, row.key, row.beside)),
        _spread([_per_gb(seen) for seen in runs], ".2f"),
        f"{max(seen['memory_mb'] for seen in runs):.0f}",
        " / ".join(f"{_median(runs, name):.3g}" for name in ("append_p50_ms", "append_p99_ms"))
        + f" / {max(seen['append_max_ms'] for seen in runs):.3g}",
        f"{_compression(runs):.2f}",
        row.note,
    )
    return f"| {row.name} | {' | '.join(cells)} |"


def _paced_table(paced: Seen) -> Iterator[str]:
    yield from _PACED_HEAD
    for coding in _CODINGS:
        for key, runs in paced.items():
            if BY_KEY[key].coding == coding:
                yield _paced_line(BY_KEY[key], _good(runs), _error(runs))


def _paced_line(row: Row, runs: list[Record], error: str | None) -> str:
    if error is not None:
        return f"| {row.name} | – | – | – | – | – | – | did not run here: {error} |"
    cells = (
        _spread([seen["append_p50_ms"] for seen in runs], ".2f"),
        _spread([seen["append_p99_ms"] for seen in runs], ".1f"),
        _spread([seen["append_max_ms"] for seen in runs], ".1f"),
        _spread([seen["late_p99_ms"] for seen in runs], ".1f"),
        _spread([_cores(seen) for seen in runs], ".2f"),
        f"{max(seen['memory_mb'] for seen in runs):.0f}",
        f"{_compression(runs):.2f}",
    )
    return f"| {row.name} | {' | '.join(cells)} |"


def _speed_verdicts(flat: Seen) -> Iterator[str]:
    for key, floor in (("raw", FLOOR), ("raw", f"{FLOOR}/plain"), ("raw/there", f"{FLOOR}/there")):
        if key in flat and floor in flat:
            ratio = _ratio(flat, key, floor)
            yield _verdict(ratio >= 0.85, f"{_plain(key)} / {_plain(floor)} at least 0.85", f"{ratio:.2f}")
    for key in flat:
        beside = BY_KEY[key].beside
        if beside in flat:
            ratio = _ratio(flat, key, beside)
            yield _verdict(ratio <= 1, f"{_plain(key)} no faster than {_plain(beside)}", f"{ratio:.2f} times")


def _paced_verdicts(paced: Seen) -> Iterator[str]:
    limits: tuple[tuple[str, float, Callable[[list[Record]], float]], ...] = (
        ("append p99 below 10 ms", 10, lambda runs: _median(runs, "append_p99_ms")),
        ("append max below 50 ms in every run", 50, lambda runs: max(seen["append_max_ms"] for seen in runs)),
        ("below 0.5 core", 0.5, lambda runs: float(np.median([_cores(seen) for seen in runs]))),
        ("memory below 400 MB", 400, lambda runs: max(seen["memory_mb"] for seen in runs)),
    )
    for key in ("lz4", "zstd", "raw"):
        runs = _good(paced.get(key, {}))
        if not runs:
            continue
        for text, limit, value in limits:
            yield _verdict(value(runs) < limit, f"{_plain(key)} paced, {text}", f"{value(runs):.3g}")
        if key != "raw":
            yield _verdict(
                _compression(runs) >= 1.7, f"{_plain(key)}, at least 1.7 times smaller", f"{_compression(runs):.3f}"
            )


def _verdict(met: bool, what: str, seen: str) -> str:
    return f"{'met' if met else '**not met**'}: {what}: {seen}"


def _reading(read: list[Record]) -> list[str]:
    parts: list[str] = []
    for cold in (False, True):
        for layout in dict.fromkeys(seen["layout"] for seen in read):
            turns = [seen["ms"] for seen in read if seen["cold"] is cold and seen["layout"] == layout]
            if not turns:
                continue
            kinds = list(next(iter(turns[0].values())))
            head = f"### Reading {'from the disk' if cold else 'from the page cache'}, ms: {layout}"
            parts += [head, "", f"| reader | {' | '.join(kinds)} |", "|---" * (len(kinds) + 1) + "|"]
            for name in turns[0]:
                cells = (_spread([turn[name][kind] for turn in turns], ".3g") for kind in kinds)
                parts.append(f"| {name} | {' | '.join(cells)} |")
            parts.append("")
    return parts


def _good(runs: dict[int, Record]) -> list[Record]:
    return [seen for seen in runs.values() if "error" not in seen]


def _error(runs: dict[int, Record]) -> str | None:
    return next((seen["error"].replace("|", "/") for seen in runs.values() if "error" in seen), None)


def _ratio(flat: Seen, key: str, beside: str | None) -> float:
    """Median of the ratios of speed within each repetition; nan where there is none."""
    theirs, ours = flat.get(key, {}), flat.get(beside or "", {})
    turns = [turn for turn in theirs if turn in ours and "error" not in theirs[turn] and "error" not in ours[turn]]
    return float(np.median([_mb_s(theirs[turn]) / _mb_s(ours[turn]) for turn in turns])) if turns else float("nan")


def _raw_mb(seen: Record) -> float:
    work = seen["work"]
    return work["lines"] * work["bands"] * work["samples"] * 2 / 1e6


def _mb_s(seen: Record) -> float:
    return _raw_mb(seen) / seen["wall_s"]


def _paced_mb_s(records: list[Record]) -> float:
    work = next(seen["work"] for seen in records if seen["record"] == "paced")
    return work["rate"] * work["bands"] * work["samples"] * 2 / 1e6


def _per_gb(seen: Record) -> float:
    return seen["cpu_s"] / _raw_mb(seen) * 1e3


def _cores(seen: Record) -> float:
    return seen["cpu_s"] / seen["wall_s"]


def _compression(runs: list[Record]) -> float:
    return _raw_mb(runs[0]) * 1e6 / runs[0]["stored_bytes"]


def _median(runs: list[Record], name: str) -> float:
    return float(np.median([seen[name] for seen in runs]))


def _spread(values: list[float], form: str) -> str:
    return f"{float(np.median(values)):{form}} ({min(values):{form}}–{max(values):{form}})"


def _number(value: float) -> str:
    return "–" if np.isnan(value) else f"{value:.2f}"


def _plain(key: str | None) -> str:
    return BY_KEY[key or ""].name.replace("*", "")
