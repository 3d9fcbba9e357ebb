"""Help, drivers, schema, twin, version, logs: everything about the command line but scanning."""

import io
import json
import subprocess
import sys
import tomllib
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest
from rich.console import Console

from scanhsi import log
from scanhsi.cli import progress, twin
from scanhsi.cli.app import app, global_options_first
from scanhsi.engine import Progress
from scanhsi.instrument.schema import schema
from support.command_line import Cli

COMMANDS = sorted(command.name or command.callback.__name__ for command in app.registered_commands if command.callback)


def test_the_commands() -> None:
    assert {"drivers", "info", "predict", "scan", "schema", "trace", "twin", "verify", "view"} <= set(COMMANDS)


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_help_with_an_example(cli: Cli, command: str) -> None:
    told = cli(command, "--help")
    assert told.code == 0
    assert f"Example: scanhsi {command}" in told.out


def test_help_tells_the_exit_codes(cli: Cli) -> None:
    assert "130 interrupted" in cli("--help").out


def test_version(cli: Cli) -> None:
    assert cli("--version").out.startswith("scanhsi ")
    assert cli("drivers", "--version").out.startswith("scanhsi ")


def test_help_loads_nothing_heavy() -> None:
    heavy = "('zarr', 'xarray', 'scipy', 'matplotlib')"
    code = f"import sys, scanhsi.cli; scanhsi.cli.run(['--help']); print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout.splitlines()[-1] == "[]"


def test_drivers(cli: Cli) -> None:
    told = cli("drivers", "--json").object
    cameras = {driver["name"]: driver for driver in told["cameras"]}
    assert cameras["simulated"]["usable"]
    assert "FreeRunning" in cameras["simulated"]["capabilities"]
    assert {driver["name"] for driver in told["actuators"]} >= {"simulated", "stepper"}
    assert "simulated" in cli("drivers").out


def test_schema(cli: Cli) -> None:
    assert json.loads(cli("schema").out) == schema()
    assert tomllib.loads(cli("schema", "--template").out)["camera"]["driver"] == "aravis"


def test_twin_hands_its_command_over(cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    point = EntryPoint("twin", f"{__name__}:fake_launcher", "scanhsi.commands")
    monkeypatch.setattr(twin, "entry_points", lambda *, group: [point] if group == "scanhsi.commands" else [])
    assert cli("twin", "--scene", "hand", "--", "scanhsi", "scan", "twin", "--log-json", "-o", "OUT").code == 5
    assert CALLS.pop() == (["scanhsi", "scan", "twin", "--log-json", "-o", "OUT"], "hand", 0)
    assert cli("twin", "--seed", 3).code == 5
    assert CALLS.pop() == (None, "testpattern", 3)


CALLS: list[tuple[list[str] | None, str, int]] = []


def fake_launcher(command: list[str] | None, *, scene: str, seed: int) -> int:
    CALLS.append((command, scene, seed))
    return 5


def test_twin_without_the_simulator(cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(twin, "entry_points", lambda *, group: [])
    told = cli("twin")
    assert told.code == 2
    assert "the twins are not installed" in told.err


def test_options_of_all_commands_may_stand_anywhere_before_the_dashes() -> None:
    words = ["scan", "x", "--log-level", "debug", "--log-file=l", "--json", "--log-json", "--", "--log-json"]
    first = ["--log-level", "debug", "--log-file=l", "--log-json", "scan", "x", "--json", "--", "--log-json"]
    assert global_options_first(words) == first
    assert global_options_first(["scan", "--log-level"]) == ["--log-level", "scan"]


def test_log_as_json_and_to_a_file(cli: Cli, mini: Path, tmp_path: Path) -> None:
    file = tmp_path / "events.jsonl"
    told = cli("scan", mini, "--virtual", "--discard", "--log-json", "--log-file", file)
    assert told.code == 0
    events = [json.loads(line) for line in told.err.splitlines() if line.startswith("{")]
    connected = [event for event in events if event["event"] == "connected"]
    assert {event["device"] for event in connected} == {"camera simulated bench", "actuator simulated bench"}
    assert all(event["operation"] == "connect" for event in connected)
    assert [json.loads(line) for line in file.read_text().splitlines()] == events


def test_nothing_is_logged_per_line_above_debug(cli: Cli, mini: Path) -> None:
    few = cli("scan", mini, "--virtual", "--discard", "--log-json", "--lines", 5).err.count('"event"')
    many = cli("scan", mini, "--virtual", "--discard", "--log-json", "--lines", 50).err.count('"event"')
    assert few == many
    assert not log.logging.getLogger().handlers or few < 10


def snapshot(taken: int, missing: int = 0) -> Progress:
    return Progress(100, taken, taken, missing, 3.0, 33.333, 0.6667, 65.4)


def test_progress_on_a_terminal_is_a_bar(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    screen = io.StringIO()
    with progress.shown(Console(file=screen, force_terminal=True, width=120)) as show:
        show(snapshot(10))
        drawn = len(screen.getvalue())
        show(snapshot(11))
        assert len(screen.getvalue()) == drawn  # at most four times a second
        now[0] = 0.26
        show(snapshot(12, missing=2))
        assert "14/100 lines  33.3 lines/s  efficiency 66.7%  1:05 left  2 lost" in screen.getvalue()


def test_progress_elsewhere_is_a_line_now_and_then(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    screen = io.StringIO()
    with progress.shown(Console(file=screen, width=40)) as show:
        for taken in range(1, 101):
            now[0] += 0.1
            show(snapshot(taken))
    lines = screen.getvalue().splitlines()
    assert lines[0] == "line 1/100, 33.3 lines/s, efficiency 66.7%, 1:05 left, 0 lost"
    assert lines[-1].startswith("line 100/100")
    assert len(lines) == 3


@pytest.mark.parametrize(
    ("seconds", "text"), [(0, "0:00"), (59.6, "1:00"), (3601, "60:01"), (float("nan"), "?"), (float("inf"), "?")]
)
def test_clock(seconds: float, text: str) -> None:
    assert progress.clock(seconds) == text
