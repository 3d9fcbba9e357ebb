"""`scanhsi twin` as a process: exit codes, the fixed port, nothing left behind, on every way out."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from scanhsi_sim.twins import netns
from scanhsi_sim.twins.launcher import PORT

pytestmark = pytest.mark.twin  # for what it needs installed

LAUNCHER = [sys.executable, "-m", "scanhsi_sim.twins.launcher"]


def launch(command: Sequence[str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*LAUNCHER, "--", *command], capture_output=True, text=True, check=False, timeout=60)


def children(pid: int) -> set[int]:
    """Processes below a process."""
    below: set[int] = set()
    for tasks in Path(f"/proc/{pid}/task").glob("*/children"):
        for child in map(int, tasks.read_text().split()):
            below |= {child} | children(child)
    return below


def alive(pids: set[int]) -> set[int]:
    return {pid for pid in pids if Path(f"/proc/{pid}").exists() and "\nState:\tZ" not in status(pid)}


def status(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return "\nState:\tZ"


def wait_until(condition: Callable[[], bool], limit_s: float = 20.0) -> None:
    deadline = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.05)


def test_the_command_finds_both_devices_and_its_exit_code_passes() -> None:
    script = f"""
import os, socket, sys
assert [n for _, n in socket.if_nameindex()] == ["lo"]
with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
    try:
        probe.bind(("127.0.0.1", 3956))
    except OSError:
        os.close(os.open({str(PORT)!r}, os.O_RDWR | os.O_NOCTTY))
        sys.exit(5)
"""
    done = launch([sys.executable, "-c", script])
    assert done.returncode == 5, done.stderr
    assert str(PORT) in done.stderr
    assert not PORT.is_symlink()


def test_a_commands_death_by_signal_is_told_as_a_shell_does() -> None:
    assert launch(["sh", "-c", "kill -KILL $$"]).returncode == 128 + signal.SIGKILL


def test_an_unknown_command_is_named() -> None:
    done = launch(["no-such-command"])
    assert done.returncode == 127
    assert "no-such-command" in done.stderr


def test_a_second_launcher_is_refused() -> None:
    done = launch([*netns.prefix(), *LAUNCHER, "--", "true"])
    assert done.returncode == 1
    assert "one running already" in done.stderr


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGKILL])
def test_everything_ends_with_the_launcher(number: signal.Signals) -> None:
    with subprocess.Popen(LAUNCHER, stdin=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as launcher:
        assert launcher.stderr is not None
        launcher.stderr.readline()
        below = children(launcher.pid)
        assert len(below) == 2
        launcher.send_signal(number)
        launcher.wait(20)
    wait_until(lambda: not alive(below))
    assert number is signal.SIGKILL or not PORT.is_symlink()


def test_ctrl_c_is_the_commands_business() -> None:
    """SIGINT to the whole group, as a terminal sends it: the command handles it, and still has both twins."""
    script = "import signal, sys, time\ntry:\n  print('up', flush=True); time.sleep(60)\nexcept KeyboardInterrupt:\n"
    script += f"  time.sleep(0.5); open({str(PORT)!r}).close(); sys.exit(9)"
    with subprocess.Popen(
        [*LAUNCHER, "--", sys.executable, "-c", script],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        start_new_session=True,
    ) as launcher:
        assert launcher.stdout is not None
        launcher.stdout.readline()
        below = children(launcher.pid)
        os.killpg(launcher.pid, signal.SIGINT)
        assert launcher.wait(20) == 9
    wait_until(lambda: not alive(below))
