"""A remote instrument, operated as a local one; needs the extra ``web``.

::

    async with scanhsi.client.connect_instrument("http://scanner.lab:8080", token=...) as hsi:
        report = await hsi.scan(scanhsi.ScanPlan(lines=300, exposure="20 ms", mode="stepped"), "hand.zarr")

The same script as with `scanhsi.open_instrument`, but for that one line. The cube is taken by the computer at the instrument, and
then brought to the path given.
"""

from scanhsi.client.remote import AsyncClient, RemoteCalibrator, RemoteCamera, RemoteMirror, connect_instrument
from scanhsi.client.sockets import Happened, SeenFrame

__all__ = [
    "AsyncClient",
    "Happened",
    "RemoteCalibrator",
    "RemoteCamera",
    "RemoteMirror",
    "SeenFrame",
    "connect_instrument",
]
