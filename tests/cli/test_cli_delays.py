"""``scanhsi delays``: record and show; the loop is closed in virtual time."""

from pathlib import Path

import pytest
import zarr

from scanhsi.cube.reader import read_records
from scanhsi.timing.delays import load_profile
from scanhsi.timing.observed import exposure_starts
from support.command_line import MINI, Cli


@pytest.fixture
def device(tmp_path: Path) -> Path:
    """The paper's delays on a small sensor."""
    path = tmp_path / "device.toml"
    path.write_text(MINI.replace('"ideal"', '"sensors2019"').replace("lines = 6", "lines = 400"))
    return path


def scanned(cli: Cli, device: Path, cube: Path, seed: int, *more: object, **settings: object) -> float:
    """Scan; return the mean line period in s."""
    chosen = {"camera.seed": seed, "actuator.seed": seed, **settings}
    words = [word for key, value in chosen.items() for word in ("--set", f"{key}={value}")]
    assert cli("scan", device, "-o", cube, "--virtual", "--mode", "stepped", *words, *more).code == 0
    starts = exposure_starts(read_records(cube).stamps)
    return float(starts[-1] - starts[0]) * 1e-9 / (len(starts) - 1)


def test_a_recorded_profile_replays_the_scan(cli: Cli, device: Path, tmp_path: Path) -> None:
    cube, profile = tmp_path / "first.zarr", tmp_path / "mine.json"
    first_s = scanned(cli, device, cube, 1)
    told = cli("delays", "record", cube, "-o", profile, "--json").object
    assert told["streams"]["T_act"]["mean_s"] == pytest.approx(11e-3, rel=0.05)
    again_s = scanned(cli, device, tmp_path / "again.zarr", 2, "--delays", profile)
    assert again_s == pytest.approx(first_s, rel=0.01)
    efficiencies = [
        cli("info", tmp_path / name, "--json").object["efficiency"] for name in ("first.zarr", "again.zarr")
    ]
    assert efficiencies[1] == pytest.approx(efficiencies[0], rel=0.01)
    predicted = cli("predict", device, "--delays", profile, "--json").object["predictions"]
    (stepped,) = [each for each in predicted if each["mode"] == "stepped"]
    assert stepped["period_s"] == pytest.approx(first_s, rel=0.01)


def test_says_where_the_numbers_come_from(cli: Cli, device: Path, tmp_path: Path) -> None:
    cube, output = tmp_path / "first.zarr", tmp_path / "mine.json"
    scanned(cli, device, cube, 1, **{"scan.lines": 20})
    written = cli("delays", "record", cube, "-o", output)
    assert written.code == 0
    assert "SIMULATED" in written.err
    profile = load_profile(output)
    assert profile.name == "mine"
    assert profile.mark.startswith("SIMULATED")
    assert "20 lines, stepped" in profile.source
    assert "simulated camera" in profile.source
    (scan,) = profile.scans
    assert (scan.lines, scan.mode, scan.steps) == (20, "stepped", 1)
    assert scan.run in profile.source
    known = profile.streams["T_rx"].dependence
    assert known is not None
    assert (known.n, list(known.acf)) == (20, [1, 2, 5])
    assert "20 lines, worth" in cli("delays", "show", output).out


def test_shows_a_profile(cli: Cli, tmp_path: Path) -> None:
    from importlib.resources import files

    profile, figure = Path(str(files("scanhsi_sim") / "profiles" / "sensors2019.json")), tmp_path / "figure.png"
    shown = cli("delays", "show", profile, "-o", figure)
    assert shown.code == 0
    assert "derived-from-text" in shown.out
    assert "T_rx Mono12Packed" in shown.out
    assert figure.read_bytes().startswith(b"\x89PNG")
    told = cli("delays", "show", profile, "--json").object
    assert told["streams"]["T_mcpy Mono8"]["mean_s"] == pytest.approx(2.2e-3)


def test_nothing_to_draw(cli: Cli, tmp_path: Path) -> None:
    profile = tmp_path / "none.json"
    profile.write_text('{"schema": 1, "name": "n", "source": "s", "mark": "m", "streams": {}}')
    assert cli("delays", "show", profile, "-o", tmp_path / "none.png", "--json").code == 2


def test_a_cube_that_no_scan_wrote(cli: Cli, device: Path, tmp_path: Path) -> None:
    cube = tmp_path / "bare.zarr"
    scanned(cli, device, cube, 1, **{"scan.lines": 4})
    del zarr.open_group(cube, mode="r+").attrs["plan"]
    told = cli("delays", "record", cube, "-o", tmp_path / "p.json", "--json")
    assert told.code == 4
    assert "does not tell its plan" in told.object["error"]["message"]
    assert not (tmp_path / "p.json").exists()


def test_bad_places(cli: Cli, tmp_path: Path) -> None:
    assert cli("delays", "record", tmp_path / "no.zarr", "-o", tmp_path / "p.json", "--json").code == 4
    assert cli("delays", "record", tmp_path / "no.zarr", "-o", tmp_path / "p.txt").code == 2
    assert cli("delays", "show", tmp_path / "no.json", "--json").code == 2


def test_compares_profiles(cli: Cli, device: Path, tmp_path: Path) -> None:
    for name, seed, settings in (
        ("a", 1, {}),
        ("b", 2, {}),
        ("slow", 3, {"scan.step": 9}),
        ("short", 4, {"scan.lines": 6}),
    ):
        scanned(cli, device, tmp_path / f"{name}.zarr", seed, **settings)
        assert cli("delays", "record", tmp_path / f"{name}.zarr", "-o", tmp_path / f"{name}.json").code == 0
    same = cli("delays", "compare", tmp_path / "a.json", tmp_path / "b.json", "--json").object
    assert {each["verdict"] for each in same["streams"] + same["replays"]} == {"no difference seen"}
    assert same["plan"]["exposure_s"] == pytest.approx(0.02)
    slower = cli("delays", "compare", tmp_path / "a.json", tmp_path / "slow.json", "--json").object
    assert [each["stream"] for each in slower["streams"] if each["verdict"] == "differ"] == ["T_act"]
    (stepped,) = [each for each in slower["replays"] if each["name"] == "period stepped"]
    assert stepped["verdict"] == "differ"
    assert stepped["difference"] == pytest.approx(2e-3, abs=0.4e-3)  # 8 steps of 0.25 ms
    shown = cli("delays", "compare", tmp_path / "a.json", tmp_path / "slow.json")
    assert "streams that differ: T_act." in shown.out
    few = cli("delays", "compare", tmp_path / "a.json", tmp_path / "short.json")
    assert "fewer than 10 independent delays, of which nothing can be told" in few.out


def test_time_per_step_from_scans_with_different_steps(cli: Cli, device: Path, tmp_path: Path) -> None:
    cubes = [tmp_path / f"{step}.zarr" for step in (1, 4, 16)]
    for cube in cubes:
        scanned(cli, device, cube, 1, **{"scan.step": cube.stem, "scan.lines": 100})
    assert cli("delays", "record", *cubes, "-o", tmp_path / "mine.json").code == 0
    profile = load_profile(tmp_path / "mine.json")
    assert profile.per_step_s("T_act") == pytest.approx(0.25e-3, rel=0.05)
    assert [scan.steps for scan in profile.scans] == [1, 4, 16]


def test_bad_comparisons(cli: Cli, device: Path, tmp_path: Path) -> None:
    cube, profile = tmp_path / "a.zarr", tmp_path / "a.json"
    scanned(cli, device, cube, 1, **{"scan.lines": 4})
    assert cli("delays", "record", cube, "-o", profile).code == 0
    for words in (["--exposure", "20"], ["--period", "0 s"], ["--pixel-format", "Mono9"], ["--pixel-format", "Mono12"]):
        assert cli("delays", "compare", profile, profile, *words, "--json").code == 2
    assert cli("delays", "compare", profile, tmp_path / "none.json", "--json").code == 2


def test_only_simulated_devices_replay(cli: Cli, tmp_path: Path) -> None:
    told = cli("scan", "template", "--discard", "--delays", tmp_path / "none.json", "--json")
    assert told.code == 2
    told = cli("scan", "sensors2019", "--discard", "--virtual", "--delays", tmp_path / "none.json", "--json")
    assert told.code == 2
    assert "cannot read the delay profile" in str(told.object["error"])
    twin = cli("scan", "twin", "--discard", "--delays", "sensors2019", "--json", "--set", "actuator.port=nowhere")
    assert twin.code == 2
    assert "camera.driver = 'aravis' is not simulated" in str(twin.object["error"]["problems"])
