"""A disk that never answers: the command says so, and ends."""

import subprocess
import sys
from pathlib import Path

SCRIPT = """
import sys, threading
import scanhsi.cli.app as app
import scanhsi.clock.real as real
import scanhsi.engine.deadlines as deadlines
import scanhsi.engine.run as engine_run
engine_run.STORE_S = 1.0
deadlines.Deadlines.__init__.__defaults__ = (1.0,)
app.EXIT_S = real.JOIN_S = 0.5
from scanhsi.cube.shards import CubeFiles
CubeFiles.write_pixels = lambda self, pixels: threading.Event().wait()
app.main()
"""


def test_a_writer_that_hangs_for_ever_does_not_keep_the_command(mini: Path, tmp_path: Path) -> None:
    words = ["scan", mini, "-o", tmp_path / "a.zarr", "--json", "--set", "storage.lines_per_shard=2"]
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, *words], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 1, done.stderr
    assert "storage, store, waited 1 s" in done.stderr or "storage, store, line" in done.stderr
    assert '"ScanFailed"' in done.stdout
