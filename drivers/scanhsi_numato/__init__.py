"""Driver for a light that a Numato USB relay module switches."""

from scanhsi.devices.light import Light
from scanhsi.devices.registry import Backend
from scanhsi_numato.light import NumatoLight
from scanhsi_numato.options import NumatoOptions

backend: Backend[Light] = Backend(
    summary="Light on a relay of a Numato USB relay module",
    options=NumatoOptions,
    device=NumatoLight,
    create=NumatoLight,
)

__all__ = ["NumatoLight", "NumatoOptions", "backend"]
