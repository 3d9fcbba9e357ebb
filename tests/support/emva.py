"""Photon transfer by emva1288, which lives in an environment of its own: its licence is LGPL, and it wants numpy 1.

``python -m venv .venv-emva && .venv-emva/bin/pip install emva1288==1.0.2 "numpy<2"``, and
``EMVA1288_PYTHON=.venv-emva/bin/python``.
"""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from scanhsi.calibration.photon_transfer import FlatPair

WORKER = Path(__file__).parents[1] / "benchmarks/accuracy/emva_worker.py"


def emva_python() -> str | None:
    return os.environ.get("EMVA1288_PYTHON")


def emva1288(pairs: Sequence[FlatPair], half: int) -> dict[str, float]:
    """What emva1288 makes of these frames; ``half`` is the index of the pair near half saturation, for DSNU and PRNU."""
    python = emva_python()
    assert python is not None
    with tempfile.TemporaryDirectory() as folder:
        temporal: dict[str, dict[str, list[str]]] = {}
        for number, pair in enumerate(pairs):
            files: dict[str, list[str]] = {}
            for photons, frames in ((1e6 * pair.exposure_s, pair.flat), (0.0, pair.dark)):
                names = [f"{number}-{photons:.0f}-{index}.npy" for index in range(2)]
                for name, frame in zip(names, frames, strict=True):
                    np.save(Path(folder) / name, np.asarray(frame, np.uint16))
                files[str(photons)] = names
            temporal[str(pair.exposure_s)] = files
        there = str(pairs[half].exposure_s)
        images = {"temporal": temporal, "spatial": {there: temporal[there]}}
        (Path(folder) / "images.json").write_text(json.dumps(images))
        environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
        done = subprocess.run(
            [python, str(WORKER), folder], stdout=subprocess.PIPE, text=True, check=True, timeout=300, env=environment
        )
    return json.loads(done.stdout)
