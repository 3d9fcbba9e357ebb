"""Side by side with peers: ``make bench-peers``, or ``.venv-peers/bin/python tests/benchmarks/peers/run.py --help``.

Every scan is a process of its own. Repetitions go round all rows, each from another one, so that whatever else the machine does
hits all alike. Every scan is appended to a file of JSON lines as it was seen; the tables are printed at the end.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any
from uuid import uuid4

from rows import ROWS, Row
from table import markdown

from scanhsi.bench.provenance import provenance

HERE = Path(__file__).parent
LIMIT_S = 300
MEMORY = Path("/dev/shm")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--lines", type=int, default=2000, help="of each scan")
    parser.add_argument("--repetitions", type=int, default=7)
    parser.add_argument("-o", "--output", type=Path, default=Path("out/bench-peers"), help="folder of peers.jsonl")
    arguments = parser.parse_args()
    arguments.output.mkdir(parents=True, exist_ok=True)
    journal, session = arguments.output / "peers.jsonl", uuid4().hex[:12]
    facts = {**provenance(), "load_before": os.getloadavg()}
    append(journal, {"record": "session", "schema": 1, "session": session, **facts})

    scans: dict[str, list[dict[str, Any]]] = {row.key: [] for row in ROWS}
    versions: dict[str, str] = {}
    for repetition in range(arguments.repetitions):
        turn = repetition * 3 % len(ROWS)
        for row in ROWS[turn:] + ROWS[:turn]:
            seen = {"row": row.key, "repetition": repetition, "lines": arguments.lines, **run(row, arguments)}
            append(journal, {"record": "scan", "session": session, **seen})
            scans[row.key].append(seen)
            versions |= seen.get("versions", {})
        print(f"repetition {repetition + 1} of {arguments.repetitions}", file=sys.stderr)

    print(f"\n{heading(facts, versions, arguments)}\n\n{markdown(scans)}\n\nobservations: {journal}")


def run(row: Row, arguments: argparse.Namespace) -> dict[str, Any]:
    """What the worker says, or why it said nothing."""
    folder = arguments.output if row.on_disk or not MEMORY.is_dir() else MEMORY
    with tempfile.TemporaryDirectory(prefix="bench-peers-", dir=folder) as scratch:
        command = [sys.executable, str(HERE / "worker.py"), row.module, row.function, str(arguments.lines)]
        command += [str(Path(scratch).resolve() / "scan.ome.zarr")] if row.stored else []
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S, check=False)
        except subprocess.TimeoutExpired:
            return {"error": f"it did not end within {LIMIT_S} s"}
    if done.returncode == 0 and done.stdout:
        return json.loads(done.stdout)
    said = done.stderr.strip().splitlines() or [f"exit status {done.returncode}"]
    return {"error": said[-1], "stderr": done.stderr[-4000:]}


def append(journal: Path, value: dict[str, Any]) -> None:
    with journal.open("a", encoding="utf-8") as file:
        file.write(json.dumps(value) + "\n")


def heading(facts: dict[str, Any], versions: dict[str, str], arguments: argparse.Namespace) -> str:
    machine, git = facts["machine"], facts["git"] or {"commit": "unknown", "changed": False}
    packages = {**versions, "Python": facts["versions"]["python"], "numpy": facts["versions"]["numpy"]}
    return "\n".join(
        (
            f"{facts['started']}, {machine['processor']}, {machine['cpus']} processors, {machine['system']} {machine['kernel']}, "
            f"load {facts['load_before'][0]:.1f} before; scanhsi {git['commit'][:9]}{' and changes' * git['changed']}.",
            ", ".join(
                f"{name} {version}" for name, version in sorted(packages.items(), key=lambda item: item[0].lower())
            )
            + ".",
            f"{arguments.repetitions} repetitions of {arguments.lines} lines: median (least–most).",
        )
    )


if __name__ == "__main__":
    main()
