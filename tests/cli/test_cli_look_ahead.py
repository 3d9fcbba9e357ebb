"""``scanhsi scan --look-ahead``: what is accepted is told before, what came of it after, and again by ``info``."""

from pathlib import Path

import pytest

from scanhsi.cli.codes import ExitCode
from support.command_line import Cli

STEPPED = ("--virtual", "--mode", "stepped", "--lines", 80)
SMALL = (
    "sensors2019",
    "--pixel-format",
    "Mono8",
    *(f"--set={s}" for s in ("roi.bands=8", "roi.samples=16", "camera.scene=dark")),
)


def test_what_is_accepted_and_what_came_of_it(cli: Cli, tmp_path: Path) -> None:
    out = tmp_path / "a.zarr"
    scanned = cli("scan", *SMALL, "-o", out, *STEPPED, "--look-ahead", "0.2")
    assert "probability of up to 0.2, 16 of 80 lines expected at most; such lines are flagged" in scanned.err
    assert "lines flagged as smeared, accepted was a probability of 0.2 a line" in scanned.out
    told = cli("info", out, "--json").object
    assert 0 < told["lines_smeared"] < 30
    assert told["attributes"]["plan"]["look_ahead"] == 0.2
    assert f"{told['lines_smeared']} lines flagged as smeared" in cli("info", out).out


def test_nothing_is_said_of_it_where_it_was_not_asked_for(cli: Cli, mini: Path, tmp_path: Path) -> None:
    scanned = cli("scan", mini, "-o", tmp_path / "a.zarr", "--virtual", "--mode", "stepped")
    assert "look-ahead" not in scanned.out + scanned.err
    assert "look-ahead" not in cli("info", tmp_path / "a.zarr").out


def test_zero_smears_nothing_and_gains(cli: Cli) -> None:
    plain = cli("scan", *SMALL, "--discard", *STEPPED, "--json").object
    sure = cli("scan", *SMALL, "--discard", *STEPPED, "--look-ahead", "0", "--json").object
    assert (plain["smeared"], sure["smeared"]) == (0, 0)
    assert (plain["look_ahead"], sure["look_ahead"]) == (None, 0)
    assert plain["period_s"] - sure["period_s"] == pytest.approx(1.7e-3, rel=0.05)


@pytest.mark.parametrize(("asked", "said"), [("2", "less than or equal to 0.5"), ("often", "valid number")])
def test_what_is_no_probability_is_refused(cli: Cli, mini: Path, asked: str, said: str) -> None:
    refused = cli("scan", mini, "--discard", *STEPPED, "--look-ahead", asked)
    assert refused.code == ExitCode.USAGE
    assert said in refused.err
