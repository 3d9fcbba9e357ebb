"""``scanhsi bench``."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from scanhsi.bench import engine
from scanhsi.bench.engine import Effort
from support.command_line import Cli


def test_lines(cli: Cli, mini: Path, tmp_path: Path) -> None:
    told = cli(
        "bench", "lines", mini, "--virtual", "-o", tmp_path / "out", "--exposures", "10 ms, 0.02 s", "--lines", "5",
        "--formats", "Mono8", "--json",
    ).object  # fmt: skip
    assert told["scans"] == 2 * (2 * 3 + 1)
    assert told["simulated"] is True
    assert len(told["figures"]) == 6
    assert all(Path(path).exists() for path in told["figures"])
    sequential = told["curves"][0]
    assert sequential["exposure_s"] == [0.01, 0.02]
    assert abs(sequential["added_s"]["value"]) < 1e-6  # an ideal instrument: nothing but exposure
    assert sequential["missing"] == 0


def test_a_second_run_is_appended(cli: Cli, mini: Path, tmp_path: Path) -> None:
    words = (
        "--virtual",
        "-o",
        tmp_path,
        "--exposures",
        "10 ms",
        "--lines",
        "3",
        "--formats",
        "Mono8",
        "--modes",
        "stepped",
    )
    sizes = []
    for _ in range(2):
        told = cli("bench", "lines", mini, *words, "--scenarios", "full")
        assert told.code == 0
        sizes.append((tmp_path / "observations.jsonl").stat().st_size)
    assert sizes[1] > 1.9 * sizes[0]
    assert "stepped" in told.out
    again = cli("bench", "draw", tmp_path)
    assert again.code == 0
    assert again.out == told.out


def test_nothing_to_draw(cli: Cli, tmp_path: Path) -> None:
    assert cli("bench", "draw", tmp_path).code == 4
    (tmp_path / "observations.jsonl").touch()
    assert "no session" in cli("bench", "draw", tmp_path).err


def test_wrong_words_are_told_with_the_right_ones(cli: Cli, mini: Path, tmp_path: Path) -> None:
    for option, value, known in (
        ("--modes", "fast", "sequential"),
        ("--formats", "Mono9", "Mono12Packed"),
        ("--scenarios", "half", "acquire"),
        ("--exposures", "20", "unit"),
    ):
        told = cli("bench", "lines", mini, "--virtual", "-o", tmp_path / "x", option, value, "--json")
        assert told.code == 2
        assert known in told.object["error"]["message"]
    assert not (tmp_path / "x").exists()


def test_real_devices_have_no_virtual_time(cli: Cli, tmp_path: Path) -> None:
    told = cli("bench", "lines", "twin", "--virtual", "-o", tmp_path / "x", "--json")
    assert told.code == 2
    assert "virtual time" in told.object["error"]["message"]


def test_help_has_an_example(cli: Cli) -> None:
    assert "Example: scanhsi bench lines" in cli("bench", "lines", "--help").out


def test_engine(cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    little = Effort(lines=10, rounds=1, wake_ups=3, timers=3, period_s=0.001, scan_lines=3)
    monkeypatch.setattr(engine, "Effort", lambda lines, rounds: replace(little, lines=lines, rounds=rounds))
    output = tmp_path / "engine.jsonl"
    words = ("--lines", "10", "--rounds", "1", "--hogs", "0", "--real-time", "gc")
    told = cli("bench", "engine", *words, "-o", output, "--json").object
    assert [loop["loop"] for loop in told["loops"]] == ["precise", "precise", "asyncio", "asyncio"]
    assert [loop["real_time"]["asked"] for loop in told["loops"]] == [[], ["gc"]] * 2
    assert min(loop["regret"]["runs"][0] for loop in told["loops"]) >= 1
    assert json.loads(output.read_text()) == told
    shown = cli("bench", "engine", *words).out
    for what in ("CPU a line, stepped", "timer late by", "precise +", "excess a line", "objects frozen"):
        assert what in shown


def test_real_time_options_are_in_the_record(cli: Cli, mini: Path, tmp_path: Path) -> None:
    words = ("bench", "lines", mini, "-o", tmp_path, "--exposures", "10 ms", "--lines", "3", "--formats", "Mono8")
    told = cli(*words, "--modes", "stepped", "--scenarios", "acquire", "--real-time", "gc", "--json").object
    assert list(told["real_time"]["granted"]) == ["gc"]
    session = json.loads((tmp_path / "observations.jsonl").read_text().splitlines()[0])
    assert session["real_time"] == told["real_time"]
    assert cli(*words, "--virtual", "--real-time", "gc").code == 2


def test_storage(cli: Cli, tmp_path: Path) -> None:
    refused = cli("bench", "storage", "-o", tmp_path, "--writers", "lz5")
    assert refused.code == 2
    assert "there are lz4" in refused.err
    words = ("--writers", "floor", "--parts", "flat out", "--lines", "4", "--bands", "8", "--samples", "8")
    told = cli("bench", "storage", "-o", tmp_path / "out", *words, "--repetitions", "1", "--json").object
    assert [record["record"] for record in told["records"]] == ["session", "flat out"]
    assert "error" not in told["records"][1]
