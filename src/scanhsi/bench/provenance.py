"""Where a measurement comes from: code, versions, machine."""

from __future__ import annotations

import os
import platform
import subprocess
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

_PACKAGES = ("scanhsi", "numpy", "scipy", "zarr", "matplotlib")


def provenance() -> dict[str, Any]:
    """What must be known of a measurement to repeat it, as plain JSON types."""
    return {
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
        "git": _git(),
        "versions": {"python": platform.python_version(), **{name: version(name) for name in _PACKAGES}},
        "machine": {
            "system": platform.system(),
            "kernel": platform.release(),
            "architecture": platform.machine(),
            "processor": _processor(),
            "cpus": os.cpu_count(),
        },
    }


def _git() -> dict[str, Any] | None:
    """Commit of the source that runs, and whether it was changed since; None outside a git checkout."""
    here = Path(__file__).parents[1]
    if (
        _ask_git(here, "ls-files", "--error-unmatch", "__init__.py") is None
    ):  # installed somewhere inside another checkout
        return None
    commit, changes = _ask_git(here, "rev-parse", "HEAD"), _ask_git(here, "status", "--porcelain", "-uno")
    return None if commit is None else {"commit": commit, "changed": bool(changes)}


def _ask_git(folder: Path, *words: str) -> str | None:
    try:
        done = subprocess.run(["git", *words], cwd=folder, capture_output=True, text=True, timeout=10, check=True)
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()


def _processor() -> str | None:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or None
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), None)
