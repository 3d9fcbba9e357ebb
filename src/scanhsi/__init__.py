"""Asynchronous hardware abstraction and a pipelined scan engine for line-scanning hyperspectral imagers.

::

    import asyncio, scanhsi

    async def main() -> None:
        async with scanhsi.open_instrument("sensors2019") as hsi:
            report = await hsi.scan(scanhsi.ScanPlan(lines=300, exposure="20 ms", mode="stepped"), "hand.zarr")
            print(report.efficiency, report.lines_per_second)

    asyncio.run(main())
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from scanhsi.cube import open_cube
    from scanhsi.cube.drain import drain
    from scanhsi.cube.exchange import export_cube, import_cube
    from scanhsi.devices.errors import ConfigError, CubeError, DeviceError, ScanFailed, ScanhsiError
    from scanhsi.engine import Mode, Progress, ScanControl, ScanPlan, ScanReport
    from scanhsi.imager import Imager, open_instrument

__all__ = [
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

_HOMES = {
    "scanhsi.cube": ("open_cube",),
    "scanhsi.cube.drain": ("drain",),
    "scanhsi.cube.exchange": ("export_cube", "import_cube"),
    "scanhsi.devices.errors": ("ConfigError", "CubeError", "DeviceError", "ScanFailed", "ScanhsiError"),
    "scanhsi.engine": ("Mode", "Progress", "ScanControl", "ScanPlan", "ScanReport"),
    "scanhsi.imager": ("Imager", "open_instrument"),
}


def __getattr__(name: str) -> object:
    """Import a public name when it is first used: xarray and zarr take most of a second, and many commands need neither."""
    for module, names in _HOMES.items():
        if name in names:
            value: object = getattr(import_module(module), name)
            globals()[name] = value
            return value
    raise AttributeError(f"module 'scanhsi' has no attribute {name!r}")
