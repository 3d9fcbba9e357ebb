"""Build the stepper's emulator bench from its C source, once per version, into the user's cache.

The program links libsimavr (GPL-3.0): it is built where it is used and never shipped.
"""

from __future__ import annotations

import hashlib
import os
import platform
import shutil
import subprocess
import tempfile
from importlib.util import find_spec
from pathlib import Path

from scanhsi.devices.errors import DeviceUnavailable

SOURCE = Path(__file__).parent / "stepper_bench"
PACKAGES = "libsimavr-dev libelf-dev gcc libc6-dev"
_FLAGS = ("-O2", "-std=gnu11", "-Wall", "-Wextra")
_LIBRARIES = ("-lsimavr", "-lelf", "-lm", "-lutil")
_HEADERS = Path("/usr/include/simavr")


def firmware_elf(name: str = "stepper") -> Path:
    """The firmware that the stepper driver ships; ``"grbl"`` is its motion core behind the interface of GRBL.

    Raises:
        DeviceUnavailable: The driver package is not installed.
    """
    spec = find_spec("scanhsi_stepper")
    path = Path(spec.origin).parent / "firmware" / f"{name}.elf" if spec and spec.origin else None
    if path is None or not path.is_file():
        raise DeviceUnavailable(
            f"the stepper firmware (scanhsi_stepper/firmware/{name}.elf) is not installed.", device="stepper twin"
        )
    return path


def missing_tools() -> str | None:
    """What this computer lacks to build the bench, and how to get it; None when nothing."""
    lacking = [
        name
        for name, present in (
            ("gcc", shutil.which("gcc") is not None),
            ("the headers of libsimavr", (_HEADERS / "sim_avr.h").is_file()),
            ("the headers of libelf", Path("/usr/include/libelf.h").is_file()),
        )
        if not present
    ]
    return f"{', '.join(lacking)} missing: apt-get install {PACKAGES}" if lacking else None


def build_bench() -> Path:
    """Path of the bench program, built now if its source or the library changed (about 1 s). Blocks.

    Raises:
        DeviceUnavailable: Compiler or libraries are missing; says which packages to install.
    """
    program = _cache() / f"stepper_bench-{_key()}"
    if program.is_file():
        return program
    program.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=program.parent) as scratch:
        built = Path(scratch) / program.name
        _compile(built)
        built.replace(program)  # atomic: two processes may build at once
    return program


def _cache() -> Path:
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "scanhsi"


def _key() -> str:
    """Changes with our source, the flags and the library's headers (their structures are compiled in)."""
    digest = hashlib.sha256(" ".join((platform.machine(), *_FLAGS, *_LIBRARIES)).encode())
    for path in (*sorted(SOURCE.glob("*.[ch]")), *sorted(_HEADERS.glob("*.h"))):
        digest.update(path.name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:16]


def _compile(output: Path) -> None:
    problem = missing_tools()
    if problem:
        raise DeviceUnavailable(f"the stepper's emulator cannot be built here, {problem}", device="stepper twin")
    sources = sorted(str(path) for path in SOURCE.glob("*.c"))
    command = ["gcc", *_FLAGS, "-o", str(output), *sources, *_LIBRARIES]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    if result.returncode:
        raise DeviceUnavailable(
            f"the stepper's emulator does not compile: {result.stderr.strip()[-1000:]}",
            device="stepper twin",
            hint=f"apt-get install {PACKAGES}",
        )
