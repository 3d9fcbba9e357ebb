"""The camera twin's own C: small files, compiled when it starts."""

import ctypes
import shutil
import subprocess
import tempfile
from pathlib import Path

_FLAGS = ("-O2", "-shared", "-fPIC", "-pthread")


class MissingRequirement(RuntimeError):
    """Something that the twin needs is not installed."""


def load(name: str, *, for_all: bool = False) -> ctypes.CDLL:
    """Compile and load one of the C files beside this one.

    Args:
        name: Its name, without ``.c``.
        for_all: Let libraries that are loaded later find its functions first.

    Raises:
        MissingRequirement: no C compiler.
    """
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        raise MissingRequirement("the camera twin needs a C compiler: apt-get install gcc libc6-dev")
    source = Path(__file__).with_name(f"{name}.c")
    with tempfile.TemporaryDirectory(prefix="scanhsi-twin-") as folder:
        library = Path(folder) / f"{name}.so"
        command = [compiler, *_FLAGS, "-o", str(library), str(source)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise MissingRequirement(f"the camera twin's {source.name} does not compile: {done.stderr.strip()}")
        return ctypes.CDLL(str(library), mode=ctypes.RTLD_GLOBAL if for_all else ctypes.RTLD_LOCAL)
