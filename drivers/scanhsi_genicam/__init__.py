"""GenICam cameras through viva-genicam: entry point ``genicam`` of scanhsi. Importing it does not import viva-genicam."""

from importlib.util import find_spec

from scanhsi.devices.camera import Camera
from scanhsi.devices.registry import Backend
from scanhsi_genicam.camera import GenicamCamera
from scanhsi_genicam.options import GenicamOptions

__all__ = ["GenicamCamera", "GenicamOptions", "backend"]


def missing() -> str | None:
    """What is not installed, and how to get it."""
    return None if find_spec("viva_genicam") else 'viva-genicam: pip install "scanhsi[genicam]"'


backend: Backend[Camera] = Backend(
    summary="GenICam camera (GigE Vision) through viva-genicam",
    options=GenicamOptions,
    device=GenicamCamera,
    create=GenicamCamera,
    missing=missing,
)
