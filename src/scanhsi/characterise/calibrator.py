"""``hsi.calibrate``: takes what a calibration needs, works it out, keeps the result and the cubes it came from."""

from __future__ import annotations

from dataclasses import dataclass, replace

from scanhsi.calibration.applies import Limits
from scanhsi.characterise.protocols.mirror import MirrorProtocols
from scanhsi.characterise.protocols.optics import OpticsProtocols
from scanhsi.characterise.protocols.sensor import SensorProtocols
from scanhsi.characterise.protocols.spectrograph import SpectrographProtocols
from scanhsi.characterise.station import Prompt, Tell


@dataclass(frozen=True, slots=True)
class Calibrator(SensorProtocols, SpectrographProtocols, OpticsProtocols, MirrorProtocols):
    """Protocols of an open instrument.

    Every method takes the cubes it needs and returns the result. With ``output`` the result is saved there (NetCDF-4) and the
    cubes are kept beside it, in ``<name>-cubes``, which must not exist; without, they are thrown away. All may be cancelled at any
    time: the mirror is stopped, what was taken whole stays a valid cube, and no result is written.

    Attributes:
        imager: The instrument.
        prompt: Asks a person to put something before it. Simulated instruments are shown their scenes without asking.
        tell: Told what is being done.
        limits: How old, and from how warm a sensor, results may be that a protocol is given.
    """

    def asking(self, prompt: Prompt | None, tell: Tell | None = None) -> Calibrator:
        """The same with somebody to ask, and to tell."""
        return replace(self, prompt=prompt, tell=tell)

    def within(self, limits: Limits) -> Calibrator:
        """The same with other limits for the age and warmth of the results that protocols are given."""
        return replace(self, limits=limits)
