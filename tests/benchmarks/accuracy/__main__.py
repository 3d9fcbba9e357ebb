"""What calibrations reach on simulated acquisitions: ``python tests/benchmarks/accuracy [sensor|wavelength|mirror ...]``.

Every number of the instrument is found by the protocols, from scans in virtual time with all errors on, and compared with
`scanhsi_sim.truth`. Prints a Markdown table; the exit status is 1 if anything is not met.
"""

from __future__ import annotations

import argparse
import importlib
import sys
import time
from pathlib import Path

from rows import markdown

PARTS = ("sensor", "emva", "wavelength", "mirror")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("parts", nargs="*", choices=(*PARTS, []), help="all by default")
    parser.add_argument("--seeds", type=int, default=20, help="instruments, where many are simulated")
    parser.add_argument(
        "--lines", metavar="FILE", help="write the wavelengths that are to be found, for identify.py, and end"
    )
    arguments = parser.parse_args()
    if arguments.lines:
        lines = importlib.import_module("wavelength").lines_to_find()
        Path(arguments.lines).write_text("\n".join(map(str, lines.wavelength_nm)))
        return 0
    missed = 0
    for part in arguments.parts or PARTS:
        began = time.perf_counter()
        rows = importlib.import_module(part).rows(arguments.seeds)
        missed += sum(not row.good for row in rows)
        print(f"\n### {part} ({time.perf_counter() - began:.0f} s)\n\n{markdown(rows)}", flush=True)
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
