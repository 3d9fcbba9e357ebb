"""``scanhsi predict``."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from support.command_line import Cli

PAPER = ("predict", "sensors2019", "--exposure", "100 ms", "--lines", "1200", "--step", "1")


def test_every_mode_and_format_of_the_papers_device(cli: Cli) -> None:
    told = cli(*PAPER, "--json").object
    found = {(each["mode"], each["pixel_format"]): each for each in told["predictions"]}
    assert len(found) == 9
    in_turn, stepped = found["sequential", "Mono12"], found["stepped", "Mono12"]
    assert in_turn["critical"] == ["T_exp", "T_rx", "T_api", "T_mcpy", "T_rand", "T_act"]
    assert in_turn["efficiency"] == pytest.approx(0.648, abs=0.002)  # Eq. 3 with 12 bits unpacked
    assert stepped["period_s"] == pytest.approx(0.1109, abs=2e-4)
    assert stepped["critical"] == ["T_exp", "T_rand", "T_act"]
    assert stepped["scan_s"] == pytest.approx(1200 * stepped["period_s"], rel=1e-3)
    sweep = found["continuous", "Mono8"]
    assert (sweep["critical"], sweep["smeared"]) == (["T_exp"], True)
    assert sweep["mtf"] == pytest.approx(0.637, abs=1e-3)
    assert told["marks"] == ["derived-from-text, not measured"]
    assert "T_store" in told["counted_as_zero"]
    assert told["gains_of_1_ms"][0]["term"] == "T_act"
    assert told["gains_of_1_ms"][0]["scan_s"] == pytest.approx(1.2)


def test_the_tables(cli: Cli) -> None:
    told = cli(*PAPER, "--pixel-format", "Mono8")
    assert told.code == 0
    for words in ("derived-from-text, not measured", "1200 lines of 100 ms", "T_exp + T_rand + T_act", "110.9 ms"):
        assert words in told.out, words
    assert "homing" in told.out
    assert "leaves 64% of the contrast" in told.out
    assert "A period of 200 ms would keep it at 50%." in told.out
    assert "(stepped, Mono8)" in told.out
    assert "1.2 s" in told.out  # of 1 ms less move


def test_nothing_to_gain_where_the_exposure_sets_the_pace(cli: Cli) -> None:
    assert "the exposure itself sets the pace" in cli(*PAPER, "--mode", "continuous").out


def test_a_longer_period_smears_less(cli: Cli) -> None:
    told = cli(*PAPER, "--mode", "continuous", "--period", "400 ms")
    assert "of the contrast" not in told.out
    assert "25%" in told.out
    assert "of the contrast" in cli(*PAPER, "--period", "400 ms", "--most-smear", "0.1").out


def test_a_camera_that_sends_its_region_only_is_faster(cli: Cli) -> None:
    def transfer_s(*more: str) -> float:
        return cli("predict", "--json", *more).object["terms_s"]["T_rx"]

    assert transfer_s("--set", "camera.whole_transfer=false") == pytest.approx(transfer_s() * 1200 / 2048)


def test_devices_that_tell_nothing(cli: Cli) -> None:
    told = cli("predict", "twin", "--json")
    assert told.code == 2
    problems = told.object["error"]["problems"]
    assert any("camera.driver = 'aravis' does not tell T_rx" in problem for problem in problems)
    assert any("actuator.driver = 'stepper' does not tell T_act" in problem for problem in problems)
    assert "--delays PROFILE.json" in told.err


def test_measured_delays_of_a_real_instrument(cli: Cli, tmp_path: Path) -> None:
    constant = {"note": "", "mark": "", "delay": {"kind": "constant", "unit": "ms", "value": 12}}
    profile = {
        "schema": 1,
        "name": "mine",
        "source": "",
        "mark": "measured here",
        "streams": {"T_act": constant, "T_rd": constant},
    }
    path = tmp_path / "mine.json"
    path.write_text(json.dumps(profile))
    told = cli("predict", "twin", "--delays", path, "--exposure", "20 ms", "--json").object
    stepped = next(each for each in told["predictions"] if each["mode"] == "stepped")
    assert stepped["period_s"] == pytest.approx(0.033)
    assert "T_rx" in told["counted_as_zero"]  # whoever does not say what is sent gets no transfer time
    region = ("--set", "roi.samples=2048", "--set", "roi.bands=1088", "--set", "camera.packet_size=8228")
    told = cli("predict", "twin", "--delays", path, "--exposure", "20 ms", *region, "--json").object
    assert told["terms_s"]["T_rx"] == pytest.approx(17.99e-3, abs=5e-6)
    assert "T_rx" not in told["counted_as_zero"]
    assert told["terms_s"]["T_ev"] == pytest.approx(1e-3)  # the margin of the driver
    apart = cli("predict", "twin", "--delays", path, "--set", "camera.overlaps_readout=false", "--json").object
    sweep = next(each for each in apart["predictions"] if each["mode"] == "continuous")
    assert sweep["period_s"] == pytest.approx(0.032)


def test_a_format_without_delays_is_refused(cli: Cli) -> None:
    told = cli("predict", "--pixel-format", "Mono16")
    assert told.code == 2
    assert "the delays of Mono16 are not known; those of Mono8, Mono12Packed, Mono12 are." in told.err


def test_nothing_takes_any_time(cli: Cli, mini: Path) -> None:
    told = cli("predict", mini)
    assert told.code == 0
    assert "the exposure itself sets the pace" in told.out
