"""GigE Vision cameras through Aravis: entry point ``aravis`` of scanhsi. Importing it loads neither PyGObject nor Aravis."""

from scanhsi.devices.camera import Camera
from scanhsi.devices.registry import Backend
from scanhsi_aravis.camera import AravisCamera
from scanhsi_aravis.lib import missing
from scanhsi_aravis.options import AravisOptions
from scanhsi_aravis.timing import timing

__all__ = ["AravisCamera", "AravisOptions", "backend"]

backend: Backend[Camera] = Backend(
    summary="GigE Vision camera through Aravis (Allied Vision Mako and others)",
    options=AravisOptions,
    device=AravisCamera,
    create=AravisCamera,
    missing=missing,
    timing=timing,
)
