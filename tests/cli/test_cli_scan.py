"""``scanhsi scan`` and ``info``: from a command line to a cube and back, in virtual time."""

import json
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from scanhsi.cli import scan
from scanhsi.cli.codes import ExitCode
from scanhsi.engine import ScanReport
from support.command_line import Cli


def test_a_scan_and_what_info_says_of_it(cli: Cli, mini: Path, tmp_path: Path) -> None:
    out = tmp_path / "hand.zarr"
    scanned = cli(
        "scan", mini, "-o", out, "--virtual", "--mode", "sequential", "--gain", "3 dB", "--start", -4, "--json"
    )
    assert scanned.code == 0
    assert scanned.object["stored"] == scanned.object["lines"] == 6
    assert scanned.object["output"] == str(out)
    assert scanned.object["simulated"] is True
    assert set(scanned.object["stages"]) >= {"exposure", "line"}

    told = cli("info", out, "--json")
    assert told.code == 0
    assert told.object["shape"] == [8, 6, 16]
    assert told.object["lines_stored"] == 6
    assert told.object["attributes"]["plan"]["gain_db"] == 3.0
    assert told.object["attributes"]["plan"]["start"] == -4
    assert told.object["efficiency"] == pytest.approx(scanned.object["efficiency"])


def test_people_get_words(cli: Cli, mini: Path, tmp_path: Path) -> None:
    scanned = cli("scan", mini, "-o", tmp_path / "a.zarr", "--virtual")
    assert "6 of 6 lines stored" in scanned.out
    assert "SIMULATED" in scanned.out
    assert "time per line" in scanned.out
    assert "line 6/6" in scanned.err
    told = cli("info", tmp_path / "a.zarr")
    assert "6 of 6 lines stored, 0 lost" in told.out
    assert "SIMULATED" in told.out
    assert "exposure    20 ms at 0 dB" in told.out


def test_virtual_scans_are_the_same_to_the_last_digit(cli: Cli) -> None:
    words = ("scan", "--virtual", "--discard", "--lines", 40, "--exposure", "100 ms", "--mode", "stepped", "--json")
    first, second, other = cli(*words, "--seed", 1), cli(*words, "--seed", 1), cli(*words, "--seed", 2)
    assert first.out == second.out
    assert first.object["period_s"] != other.object["period_s"]
    assert first.object["output"] is None


def test_set_changes_a_key_of_the_instrument(cli: Cli, mini: Path) -> None:
    words = ("scan", mini, "--virtual", "--discard", "--json")
    assert cli(*words, "--set", "scan.lines=4", "--set", "scan.exposure=50 ms").object["exposure_s"] == 0.05
    assert cli(*words, "--set", "scan.lines=4").object["lines"] == 4
    assert cli(*words, "--set", "scan.lines=4", "--lines", 5).object["lines"] == 5
    refused = cli(*words, "--set", "camera.sceen='hand'")
    assert refused.code == 2
    assert refused.object["error"]["problems"] == ['camera.sceen = "hand": there is no such key; did you mean scene?']
    assert cli(*words, "--set", "lines").code == 2


def report(**changes: object) -> ScanReport:
    whole = {
        "mode": "stepped",
        "lines": 9,
        "stored": 9,
        "missing": 0,
        "exposure_s": 0.02,
        "duration_s": 1.0,
        "period_s": 0.025,
        "lines_per_second": 40.0,
        "efficiency": 0.8,
        "bound_s": None,
        "regret": None,
        "output": "a.zarr",
        "simulated": False,
    }
    return ScanReport(**{**whole, **changes})  # type: ignore[arg-type]


LOST = {3: "3 packets missing", 4: "no free buffer"}


@pytest.mark.parametrize(
    ("changes", "code", "words"),
    [
        ({"stored": 7, "missing": 2, "missing_reasons": LOST}, 1, "7 of 9 lines stored, 2 lost"),
        ({"stored": 5, "stopped_early": True}, 130, "stopped early: 5 of 9 lines stored"),
    ],
)
def test_less_than_a_whole_cube_is_no_success(
    changes: dict[str, object], code: int, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    for as_json in (False, True):
        with pytest.raises(Exception) as caught:
            scan._finish(report(**changes), as_json=as_json)
        assert caught.value.exit_code == code  # type: ignore[attr-defined] typer.Exit
    printed = capsys.readouterr().out
    assert words in printed
    if "missing_reasons" in changes:
        assert "line 3 lost: 3 packets missing" in printed


@pytest.mark.parametrize("presses", [1, 2])
def test_ctrl_c(mini: Path, tmp_path: Path, presses: int, cli: Cli) -> None:
    """One finishes the line, two cancel it; the cube opens either way."""
    out = tmp_path / "a.zarr"
    exposure = "0.3 s" if presses == 1 else "2 s"
    command = [
        sys.executable,
        "-m",
        "scanhsi",
        "scan",
        mini,
        "-o",
        out,
        "--lines",
        "100",
        "--exposure",
        exposure,
        "--json",
    ]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1)
    assert process.stderr is not None
    heard = [next(line for line in process.stderr if line.startswith("line 1/100"))]  # and the next is being exposed
    process.send_signal(signal.SIGINT)
    heard.append(next(line for line in process.stderr if "finishing the line" in line))
    if presses == 2:
        process.send_signal(signal.SIGINT)
    stdout, stderr = process.communicate(timeout=60)
    heard.append(stderr)
    assert process.returncode == ExitCode.INTERRUPTED, heard
    assert "Traceback" not in stderr
    told = cli("info", out, "--json").object
    if presses == 1:
        assert '"stopped_early": true' in stdout
        assert 2 <= told["lines_stored"] < 100
    else:
        assert '"type": "Interrupted"' in stdout
        assert f"what was stored before is safe: scanhsi info {out}" in stderr
        assert told["lines_stored"] == 1


def test_a_scan_stopped_before_its_first_line_has_no_speed(capsys: pytest.CaptureFixture[str]) -> None:
    nan = float("nan")
    nothing = report(stored=0, stopped_early=True, period_s=nan, lines_per_second=nan, efficiency=nan, duration_s=0.0)
    with pytest.raises(Exception) as caught:
        scan._finish(nothing, as_json=False)
    assert caught.value.exit_code == ExitCode.INTERRUPTED  # type: ignore[attr-defined] typer.Exit
    printed = capsys.readouterr().out
    assert "0 of 9 lines stored" in printed
    assert "nan" not in printed


def test_with_log_json_stderr_holds_nothing_but_json_lines(tmp_path: Path) -> None:
    for extra, code in (([], 0), (["--exposure", "9 s"], 2)):
        done = subprocess.run(
            [sys.executable, "-m", "scanhsi", "--log-json", "scan", "--virtual", "--discard", "--lines", "3", *extra],
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == code
        events = [json.loads(line) for line in done.stderr.splitlines()]
        assert {"connected"} < {event["event"] for event in events}
    assert events[-1]["level"] == "error"
    assert "allowed is" in events[-1]["message"]


def test_real_time_options_are_told_and_kept_in_the_cube(cli: Cli, mini: Path, tmp_path: Path) -> None:
    out = tmp_path / "a.zarr"
    told = cli("scan", mini, "-o", out, "--real-time", "gc,switch", "--json").object["real_time"]
    assert told["loop"] == "precise"
    assert told["asked"] == ["gc", "switch"] == list(told["granted"])
    assert told["refused"] == {}
    assert cli("info", out, "--json").object["attributes"]["real_time"] == told
    assert "real time" in cli("scan", mini, "--discard", "--real-time", "gc").out
    assert "objects frozen" in cli("info", out).out
    unasked = cli("scan", mini, "--discard", "--virtual", "--json").object["real_time"]
    assert unasked == {"loop": "virtual", "asked": [], "granted": {}, "refused": {}}


@pytest.mark.parametrize(("words", "why"), [(("gc", "--virtual"), "never late"), (("fast",), "gc, fifo, switch")])
def test_wrong_real_time_options_are_refused(cli: Cli, mini: Path, words: tuple[str, ...], why: str) -> None:
    told = cli("scan", mini, "--discard", "--real-time", *words, "--json")
    assert told.code == 2
    assert why in told.object["error"]["message"]


def test_a_sweep_that_smears_is_told_once(cli: Cli, mini: Path) -> None:
    words = ("scan", mini, "--discard", "--virtual", "--mode", "continuous", "--exposure", "20 ms")
    told = cli(*words, "--period", "25 ms")
    assert told.err.count("of the contrast") == 1
    assert "80% of a line" in " ".join(told.err.split())
    assert "of the contrast" not in cli(*words, "--period", "50 ms").err
    assert "of the contrast" not in cli("scan", mini, "--discard", "--virtual", "--exposure", "20 ms").err


def test_the_speed_is_that_of_lines_delivered(cli: Cli, tmp_path: Path) -> None:
    """A short scan exposes its lines faster than the link carries them; the report and ``info`` tell the link's pace."""
    out = tmp_path / "short.zarr"
    words = (
        "--virtual",
        "--lines",
        "16",
        "--exposure",
        "10 ms",
        "--pixel-format",
        "Mono12",
        "--set",
        "camera.scene=dark",
    )
    period_s = cli("scan", "sensors2019", "-o", out, *words, "--json").object["period_s"]
    assert period_s == pytest.approx(0.039, rel=0.01)
    assert cli("info", out, "--json").object["period_s"] == pytest.approx(period_s)
