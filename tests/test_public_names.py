"""The public names of the package, and that using few of them costs little."""

import subprocess
import sys

import scanhsi


def test_every_public_name_exists_and_nothing_else_is_promised() -> None:
    assert all(getattr(scanhsi, name) is not None for name in scanhsi.__all__)
    assert sorted(scanhsi.__all__) == [
        "ConfigError",
        "CubeError",
        "DeviceError",
        "Imager",
        "Mode",
        "Progress",
        "ScanControl",
        "ScanFailed",
        "ScanPlan",
        "ScanReport",
        "ScanhsiError",
        "drain",
        "export_cube",
        "import_cube",
        "open_cube",
        "open_instrument",
    ]


def test_importing_scanhsi_pulls_in_no_heavy_library() -> None:
    code = "import scanhsi, scanhsi.clock, sys; print([m for m in ('matplotlib', 'xarray', 'gi', 'serial') if m in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"
