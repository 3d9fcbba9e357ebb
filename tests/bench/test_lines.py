"""``scanhsi bench lines`` on the paper's instrument in virtual time, and on a small one in real time."""

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest

from scanhsi import clock
from scanhsi.bench.curves import Curve, curves
from scanhsi.bench.figures import draw_figures
from scanhsi.bench.lines import LineSweep, measure_lines
from scanhsi.bench.observations import OBSERVATIONS, Session, read_sessions
from scanhsi.bench.scenarios import Scenario
from scanhsi.devices import PixelFormat
from scanhsi.devices.errors import OutOfRange
from scanhsi.engine import Mode
from scanhsi.instrument import load_instrument
from scanhsi.instrument.timing import timing_of
from scanhsi.timing.spans import shares
from scanhsi_sim.options import find_profile

PAPER = LineSweep(formats=[PixelFormat.MONO8, PixelFormat.MONO12])
SUM = ("T_rx", "T_api", "T_mcpy", "T_act", "T_rand")


@cache
def paper() -> Session:
    with TemporaryDirectory() as folder:
        return measure("sensors2019", PAPER, Path(folder))


def measure(instrument: str | Path, sweep: LineSweep, folder: Path, *, virtual: bool = True) -> Session:
    config = load_instrument(instrument)
    return clock.run(measure_lines(config, sweep, folder, command="test"), virtual=virtual)


def curve_of(mode: Mode, scenario: Scenario, pixel_format: PixelFormat) -> Curve:
    (found,) = [
        curve
        for curve in curves(paper().observations)
        if (curve.mode, curve.scenario, curve.pixel_format) == (mode, scenario, pixel_format)
    ]
    return found


def profile_s(streams: tuple[str, ...], pixel_format: PixelFormat) -> float:
    profile = find_profile("sensors2019")
    return sum(profile.mean_s(stream, pixel_format=pixel_format, steps=1) for stream in streams)


def test_overhead_is_the_sum_of_the_profile() -> None:
    law = curve_of(Mode.SEQUENTIAL, Scenario.FULL, PixelFormat.MONO8).law
    assert profile_s(SUM, PixelFormat.MONO8) == pytest.approx(0.03333, abs=1e-6)
    assert profile_s(SUM, PixelFormat.MONO8) in law.added
    assert law.added.high - law.added.low < 0.0005
    assert law.r2 > 0.999


def test_overhead_has_no_bias(tmp_path: Path) -> None:
    """Eight times the lines: the interval is narrow enough to tell that a frame which is early waits for its read-out."""
    sweep = LineSweep(lines=400, formats=[PixelFormat.MONO8], modes=[Mode.SEQUENTIAL], scenarios=[Scenario.FULL])
    (curve,) = curves(measure("sensors2019", sweep, tmp_path).observations)
    drawn = timing_of(load_instrument("sensors2019")).delays(100_000, 0.1, PixelFormat.MONO8, 1)
    waits_s = float(np.maximum(drawn.readout_ns - drawn.transfer, 0).mean()) * 1e-9
    assert waits_s == pytest.approx(82e-6, rel=0.03)
    added = curve.law.added
    assert added.high - added.low < 0.00015
    assert profile_s(SUM, PixelFormat.MONO8) + waits_s in added


def test_efficiency_of_the_paper() -> None:
    curve = curve_of(Mode.SEQUENTIAL, Scenario.FULL, PixelFormat.MONO8)
    measured = dict(zip(curve.exposure_s.tolist(), (curve.exposure_s / curve.period_s).tolist(), strict=True))
    assert measured[0.1] == pytest.approx(0.75, abs=0.01)
    assert measured[0.2] == pytest.approx(0.857, abs=0.01)
    assert measured[0.3] == pytest.approx(0.900, abs=0.01)


@pytest.mark.parametrize("mode", [Mode.SEQUENTIAL, Mode.STEPPED])
def test_acquiring_alone_the_link_is_the_limit(mode: Mode) -> None:
    """49.5 lines/s at 8 bit. At 12 bit unpacked the wire alone would allow 27.04; the profile's T_api takes that to 25.6."""
    limits = {kind: curve_of(mode, Scenario.ACQUIRE, kind).law.limit_lps for kind in (PAPER.formats or ())}
    assert limits[PixelFormat.MONO8] == pytest.approx(49.5, rel=0.01)
    assert limits[PixelFormat.MONO12] == pytest.approx(1 / profile_s(("T_rx", "T_api"), PixelFormat.MONO12), rel=0.005)
    assert 1 / profile_s(("T_rx",), PixelFormat.MONO12) == pytest.approx(27.04, abs=0.01)


def test_each_scenario_lacks_what_it_says() -> None:
    full, static, acquire = (
        curve_of(Mode.SEQUENTIAL, scenario, PixelFormat.MONO12).law.added.value for scenario in Scenario
    )
    assert full - static == pytest.approx(profile_s(("T_act", "T_rand"), PixelFormat.MONO12), rel=0.02)
    assert static - acquire == pytest.approx(profile_s(("T_mcpy",), PixelFormat.MONO12), rel=0.02)


def test_a_stepped_scan_costs_the_move_or_the_link() -> None:
    law = curve_of(Mode.STEPPED, Scenario.FULL, PixelFormat.MONO12).law
    assert profile_s(("T_act", "T_rand"), PixelFormat.MONO12) in law.added
    assert law.floor is not None
    assert profile_s(("T_rx", "T_api"), PixelFormat.MONO12) in law.floor


def test_a_continuous_scan_reaches_full_efficiency() -> None:
    curve = curve_of(Mode.CONTINUOUS, Scenario.FULL, PixelFormat.MONO8)
    assert (curve.exposure_s / curve.period_s)[-1] == pytest.approx(1, abs=0.001)
    assert curve.missing == 0


def test_solid_bars_add_up_to_the_line_period() -> None:
    for seen in paper().observations:
        alone = sum(share.alone_s for share in shares(seen.stamps).values())
        assert alone == pytest.approx(float(seen.periods_s.mean()), rel=1e-9)


def test_exposures_are_independent_and_all_else_is_paired() -> None:
    seeds = {(seen.exposure_s, seen.seed) for seen in paper().observations}
    assert len(seeds) == len({exposure for exposure, _ in seeds}) == len({seed for _, seed in seeds}) == 11


def test_provenance_is_written_down(tmp_path: Path) -> None:
    facts = measure("sensors2019", LineSweep(lines=3, exposures_s=[0.02], modes=[Mode.STEPPED]), tmp_path).facts
    assert facts["virtual_time"] is facts["simulated"] is True
    assert facts["machine"]["cpus"] >= 1
    assert {"scanhsi", "python", "numpy"} <= facts["versions"].keys()
    assert "git" in facts
    assert facts["instrument"]["name"] == "sensors2019"
    assert "not measured" in facts["devices"]["camera"]["firmware"]
    (session,) = read_sessions(tmp_path / OBSERVATIONS)
    assert session.facts["started"] == facts["started"]


def test_the_same_seed_measures_the_same(tmp_path: Path) -> None:
    sweep = LineSweep(lines=5, exposures_s=[0.02], formats=[PixelFormat.MONO8])
    one, other = (measure("sensors2019", sweep, tmp_path / name) for name in ("a", "b"))
    for first, second in zip(one.observations, other.observations, strict=True):
        assert first.periods_s.tolist() == second.periods_s.tolist()


def test_what_is_not_allowed_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    with pytest.raises(OutOfRange, match="exposure"):
        measure("sensors2019", LineSweep(exposures_s=[0.02, 99.0]), tmp_path / "x")
    assert not (tmp_path / "x").exists()


def test_figures(tmp_path: Path) -> None:
    paths = draw_figures(paper(), curves(paper().observations), tmp_path)
    assert {path.name.split("-")[0] for path in paths} == {"figure5", "figure6", "figure13"}
    assert {path.suffix for path in paths} == {".png", ".pdf"}
    assert all(path.stat().st_size > 5000 for path in paths)


def test_figures_of_very_little(tmp_path: Path) -> None:
    sweep = LineSweep(
        lines=3, exposures_s=[0.2], formats=[PixelFormat.MONO8], modes=[Mode.STEPPED], scenarios=[Scenario.STATIC]
    )
    session = measure("sensors2019", sweep, tmp_path)
    assert len(draw_figures(session, curves(session.observations), tmp_path)) == 2


def test_real_time_stores_the_lines_and_deletes_them_again(tmp_path: Path, mini: Path) -> None:
    sweep = LineSweep(lines=4, exposures_s=[0.01], formats=[PixelFormat.MONO8], modes=[Mode.STEPPED])
    session = measure(mini, sweep, tmp_path / "out", virtual=False)
    assert [seen.scenario for seen in session.observations] == list(Scenario)
    full, _, acquire = (seen.stamps for seen in session.observations)
    assert (full["stored"] > full["copied"]).all()
    assert (acquire["stored"] >= acquire["copied"]).all()
    assert [path.name for path in (tmp_path / "out").iterdir()] == [OBSERVATIONS]
