"""Recovery from the command line: interrupted scans are finished, running ones paused, what is unsafe is told."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from scanhsi.cli.codes import ExitCode
from scanhsi.clock import run_virtual
from scanhsi.devices.errors import DeviceLost, DeviceUnsafe, ScanFailed
from scanhsi.engine import ScanControl
from scanhsi.imager import open_instrument
from scanhsi.instrument import load_instrument
from support.command_line import Cli


def interrupted(mini: Path, out: Path) -> int:
    """A scan that was stopped early; its lines."""

    async def main() -> int:
        control = ScanControl()
        async with open_instrument(load_instrument(str(mini))) as hsi:

            def stop_at_three(progress: object) -> None:
                if getattr(progress, "taken", 0) >= 3:
                    control.stop.set()

            plan = hsi.default_plan(exposure="300 ms")
            return (await hsi.scan(plan, out, control=control, on_progress=stop_at_three)).stored

    return run_virtual(main())


def test_an_interrupted_scan_is_finished_and_info_says_who_took_what(cli: Cli, mini: Path, tmp_path: Path) -> None:
    out = tmp_path / "a.zarr"
    stored = interrupted(mini, out)
    assert 0 < stored < 6
    told = cli("scan", "--resume", out, "--virtual", "--on-fault", "retry", "--json")
    assert told.code == 0, told.err
    assert (told.object["stored"], told.object["resumed_at"]) == (6, stored)
    runs = cli("info", out, "--json").object["runs"]
    assert [(run["first"], run["last"]) for run in runs] == [(0, stored - 1), (stored, 5)]
    assert runs[0]["run"] != runs[1]["run"]
    shown = cli("info", out).out
    assert f"lines 0 to {stored - 1}: run {runs[0]['run']}" in shown
    assert cli("scan", "--resume", out, "--virtual").code == ExitCode.CUBE


def test_resume_refuses_what_is_decided_already(cli: Cli, mini: Path, tmp_path: Path) -> None:
    out = tmp_path / "a.zarr"
    interrupted(mini, out)
    refused = cli("scan", "--resume", out, "--lines", 9, "--json")
    assert refused.code == ExitCode.USAGE
    assert "as it was when the cube was begun" in refused.object["error"]["message"]
    assert cli("scan", "--resume", out, "-o", out).code == ExitCode.USAGE
    assert cli("scan", "--resume", out, "--codec", "zstd").code == ExitCode.USAGE
    other = cli("scan", mini, "--resume", out, "--virtual", "--set", "camera.scene=white", "--json")
    assert other.code == ExitCode.USAGE
    assert any("instrument.camera.scene" in problem for problem in other.object["error"]["problems"])


def test_a_scan_is_paused_and_goes_on(mini: Path, tmp_path: Path, cli: Cli) -> None:
    out = tmp_path / "a.zarr"
    command = [sys.executable, "-m", "scanhsi", "scan", mini, "-o", out, "--lines", "6", "--exposure", "0.2 s"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1)
    assert process.stderr is not None
    next(line for line in process.stderr if line.startswith("line 1/6"))
    process.send_signal(signal.SIGTSTP)
    next(line for line in process.stderr if line.startswith("paused"))
    process.send_signal(signal.SIGTSTP)
    next(line for line in process.stderr if "going on" in line)
    stdout, stderr = process.communicate(timeout=60)
    assert process.returncode == 0, stderr
    assert "0 faults, 1 pause, " in stdout
    (incident,) = cli("info", out, "--json").object["incidents"]
    assert incident["kind"] == "pause"


def test_what_is_unsafe_has_an_exit_code_of_its_own(cli: Cli, mini: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    unsafe = DeviceUnsafe("UNSAFE, the mirror may be moving: it is gone.", device="actuator x", hint="look at it.")
    failed = ScanFailed([DeviceLost("gone"), unsafe], stored=1, lines=6)

    async def fail(*_: object, **__: object) -> None:
        raise failed

    monkeypatch.setattr("scanhsi.imager.run_scan", fail)
    told = cli("scan", mini, "--discard", "--virtual", "--json")
    assert told.code == ExitCode.UNSAFE
    assert told.object["error"]["unsafe"] == ["actuator x"]
    assert "UNSAFE, the mirror may be moving: it is gone. (actuator x): look at it." in told.err
