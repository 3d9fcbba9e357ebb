"""``scanhsi trace``."""

import json
from pathlib import Path

from scanhsi.cube.reader import read_records
from support.command_line import Cli


def test_traces_a_scan(cli: Cli, mini: Path, tmp_path: Path) -> None:
    cube, output = tmp_path / "x.zarr", tmp_path / "trace.json"
    assert cli("scan", mini, "-o", cube, "--virtual").code == 0
    told = cli("trace", cube, "-o", output, "--json").object
    assert told["lines"] == 6
    assert told["simulated"] is True
    events = json.loads(output.read_text())["traceEvents"]
    exposures = [event for event in events if event["ph"] == "X" and event["name"] == "exposure"]
    stamps = read_records(cube).stamps
    lengths_us = (stamps["exposure_end"] - stamps["exposure_start"]) / 1000
    assert [event["dur"] for event in exposures] == lengths_us.tolist()
    assert told["spans"] == len([event for event in events if event["ph"] == "X"])


def test_says_what_to_open(cli: Cli, mini: Path, tmp_path: Path) -> None:
    cube = tmp_path / "x.zarr"
    cli("scan", mini, "-o", cube, "--virtual")
    assert "ui.perfetto.dev" in cli("trace", cube, "-o", tmp_path / "trace.json").err


def test_a_place_that_cannot_be_written(cli: Cli, mini: Path, tmp_path: Path) -> None:
    cube = tmp_path / "x.zarr"
    cli("scan", mini, "-o", cube, "--virtual")
    told = cli("trace", cube, "-o", tmp_path / "nowhere" / "trace.json", "--json")
    assert told.code == 4
    assert "cannot write" in told.object["error"]["message"]


def test_no_cube(cli: Cli, tmp_path: Path) -> None:
    assert cli("trace", tmp_path / "none.zarr", "-o", tmp_path / "trace.json", "--json").code == 4
