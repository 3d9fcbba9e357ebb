"""What `predict` says that look-ahead gains is what a scan in virtual time gains."""

from __future__ import annotations

import pytest
from typer.testing import CliRunner

from scanhsi.cli.app import app
from scanhsi.instrument import load_instrument
from scanhsi.instrument.timing import timing_of
from scanhsi.timing.prediction import lead_s


def test_the_lead_is_the_quantile_of_the_latency() -> None:
    timing = timing_of(load_instrument("sensors2019"))
    leads_ms = [lead_s(timing, accepted) * 1e3 for accepted in (0, 0.01, 0.1)]
    assert leads_ms == pytest.approx([1.7, 1.88, 2.11], abs=0.08)


def test_without_a_latency_in_the_profile_there_is_none() -> None:
    config = load_instrument("sensors2019", {"actuator.profile": "ideal"})
    assert lead_s(timing_of(config), 0.01) == 0


def test_predict_tells_it_where_it_would_gain_something() -> None:
    run = CliRunner()
    stepped = run.invoke(app, ["predict", "--mode", "stepped", "--exposure", "100 ms", "--pixel-format", "Mono8"])
    assert "--look-ahead 0.01 would send each move 1.8" in stepped.output
    assert "1.0%" in stepped.output
    sequential = run.invoke(app, ["predict", "--mode", "sequential", "--exposure", "100 ms"])
    assert "look-ahead" not in sequential.output
