"""Wrong input: a clear message, a meaningful exit code, no traceback, nothing overwritten."""

import asyncio
import json
from pathlib import Path

import pytest

from scanhsi.cli.codes import ExitCode, exit_code_of
from scanhsi.cli.output import describe_error
from scanhsi.devices import errors
from support.command_line import MINI, Cli


def check(cli: Cli, code: int, fragment: str, *words: object) -> None:
    """The same failure, told to people and to programs."""
    told = cli(*words)
    assert told.code == code
    assert told.out == ""
    assert fragment in " ".join(told.err.split())
    assert "Traceback" not in told.err
    as_json = cli(*words, "--json")
    assert as_json.code == code
    described = as_json.object["error"]
    assert described["exit_code"] == code
    assert described["type"]


CAMERA = 'driver = "simulated"\nprofile = "ideal"\nscene'
ACTUATOR = 'driver = "simulated"\nprofile = "ideal"\n[geometry]'
NO_DRIVER = "camera.driver = \"simulatd\": there is no camera driver 'simulatd'; installed are: aravis, "


@pytest.mark.parametrize(
    ("old", "new", "code", "fragment"),
    [
        (CAMERA, 'driver = "simulatd"\nscene', 2, NO_DRIVER),
        (ACTUATOR, 'driver = "stepper"\nport = "/dev/no-such-port"\n[geometry]', 3, "/dev/no-such-port"),
        ("[geometry]", "[geometry", 2, "mini.toml is not valid TOML: Expected ']'"),
        ("[geometry]", "[geometry", 2, "(at line 11, column 10)"),
        (
            'distance = "350 mm"',
            "distance = 350",
            2,
            "geometry.distance = 350: has no unit; write a number with one of",
        ),
        ("lines = 6", "lines = 6\nperiod = 3", 2, "scan.period = 3: has no unit"),
    ],
)
def test_wrong_instrument_files(cli: Cli, mini: Path, old: str, new: str, code: int, fragment: str) -> None:
    assert old in MINI
    mini.write_text(MINI.replace(old, new))
    check(cli, code, fragment, "scan", mini, "--discard")


@pytest.mark.parametrize(
    ("words", "fragment"),
    [
        (["--exposure", "5 ms"], "exposure 0.005 s is not allowed; allowed is 0.01 to 2 s"),
        (["--gain", "26 dB"], "gain 26 dB is not allowed; allowed is 0 to 25 dB"),
        (["--pixel-format", "Mono16"], "pixel format Mono16 is not allowed; allowed are Mono8"),
        (["--start", "2398"], "position 2403 steps is not allowed; allowed is -2400 to 2400 steps"),
        (["--exposure", "100"], 'exposure = "100": has no unit'),
        (
            ["--lines", "0", "--mode", "fast"],
            "mode = \"fast\": input should be 'sequential', 'stepped' or 'continuous'",
        ),
        (["--set", "roi.samples=99", "--set", "roi.bands=8"], "roi: samples end at 99, the sensor"),
    ],
)
def test_wrong_plans(cli: Cli, mini: Path, words: list[str], fragment: str) -> None:
    check(cli, 2, fragment, "scan", mini, "--discard", "--virtual", *words)


def test_an_existing_output_is_not_touched(cli: Cli, mini: Path, tmp_path: Path) -> None:
    out = tmp_path / "there.zarr"
    out.mkdir()
    (out / "notes.txt").write_text("precious")
    check(cli, 4, str(out), "scan", mini, "--virtual", "-o", out)
    assert [item.name for item in out.iterdir()] == ["notes.txt"]
    assert (out / "notes.txt").read_text() == "precious"


def test_not_a_cube(cli: Cli, mini: Path, tmp_path: Path) -> None:
    check(cli, 4, "is a file; a cube is a folder", "info", mini)
    check(cli, 4, "there is no", "info", tmp_path / "nothing.zarr")
    check(cli, 4, "no Zarr group", "info", tmp_path)


def test_wrong_command_lines(cli: Cli, mini: Path) -> None:
    check(cli, 2, "there is no instrument 'sensors2018'; did you mean sensors2019?", "scan", "sensors2018", "--discard")
    check(cli, 2, "say where the cube goes with -o OUT, or --discard it", "scan", mini)
    check(cli, 2, "say where the cube goes", "scan", mini, "--discard", "-o", "x.zarr")
    check(cli, 2, "No such option", "scan", mini, "--discard", "--speed", "9")
    check(
        cli,
        2,
        "cannot run in virtual time: - camera.driver = 'aravis' talks to something outside",
        "scan",
        "twin",
        "--discard",
        "--virtual",
    )
    check(cli, 2, "camera.driver = 'aravis' draws nothing at random", "scan", "twin", "--discard", "--seed", "1")  # fmt: skip
    assert cli("scna").code == 2
    assert cli("--log-file", "/no/such/folder/log", "drivers").code == 2


def test_debugging_shows_the_traceback(cli: Cli) -> None:
    for words in (
        ["--log-level", "debug", "scan", "nothing", "--discard"],
        ["scan", "nothing", "--discard", "--log-level=debug"],
    ):
        told = cli(*words)
        assert told.code == 2
        assert "Traceback" in told.err
        assert "error: there is no instrument" in told.err


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (errors.ScanFailed([errors.DeviceLost("gone.")], stored=3, lines=9), 1),
        (errors.ConfigError("wrong"), 2),
        (errors.OutOfRange("too long"), 2),
        (errors.UnsupportedFeature("cannot"), 2),
        (errors.DeviceNotFound("nobody"), 3),
        (errors.DeviceBusy("taken"), 3),
        (errors.DeviceUnavailable("no library"), 3),
        (errors.PositionLost("where?"), 3),
        (errors.CubeExists("there"), 4),
        (errors.NotACube("no"), 4),
        (errors.CubeError("disk full"), 4),
        (ZeroDivisionError("bug"), 70),
        (KeyboardInterrupt(), 130),
        (asyncio.CancelledError(), 130),
    ],
)
def test_exit_codes(error: BaseException, code: int) -> None:
    assert exit_code_of(error) == code
    described = describe_error(error)
    assert described["exit_code"] == code
    json.dumps(described)


def test_every_error_of_the_tree_has_an_exit_code_of_its_own_kind() -> None:
    kinds = [kind for kind in vars(errors).values() if isinstance(kind, type) and issubclass(kind, errors.ScanhsiError)]
    assert len(kinds) > 15
    for kind in kinds:
        error = kind([ValueError("x")], stored=0, lines=1) if kind is errors.ScanFailed else kind("x")
        assert exit_code_of(error) not in (ExitCode.OK, ExitCode.INTERNAL)


def test_a_failed_scan_tells_programs_its_causes() -> None:
    cause = errors.DeviceTimeout(
        "no frame.", device="camera x", operation="frame", line=4, waited_s=0.5, hint="the cable"
    )
    described = describe_error(errors.ScanFailed([cause, ValueError("then")], stored=3, lines=9, output="a.zarr"))
    assert (described["stored"], described["lines"], described["output"]) == (3, 9, "a.zarr")
    first, second = described["causes"]
    assert first == {
        "type": "DeviceTimeout",
        "message": "no frame.",
        "exit_code": 3,
        "device": "camera x",
        "operation": "frame",
        "line": 4,
        "waited_s": 0.5,
        "hint": "the cable",
    }
    assert second["message"] == "then"


def test_devices_that_fail_together_are_told_one_by_one(cli: Cli, mini: Path) -> None:
    port = 'driver = "stepper"\nport = "/dev/no-such-port"\n[geometry]'
    mini.write_text(MINI.replace(ACTUATOR, port))
    assert cli("scan", mini, "--discard", "--json").object["error"]["type"] == "DeviceNotFound"
    both = errors.DeviceError("2 devices did not connect:")
    both.__cause__ = ExceptionGroup(
        "", [errors.DeviceBusy("taken", device="camera x"), errors.DeviceNotFound("no port")]
    )
    assert [cause["type"] for cause in describe_error(both)["causes"]] == ["DeviceBusy", "DeviceNotFound"]


def test_a_bug_is_shown_whole(cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    def bug(*_: object) -> None:
        raise ZeroDivisionError("deep inside")

    monkeypatch.setattr("scanhsi.instrument.load_instrument", bug)
    told = cli("scan", "--discard")
    assert told.code == 70
    assert "Traceback" in told.err
    assert "report this as a bug" in told.err
