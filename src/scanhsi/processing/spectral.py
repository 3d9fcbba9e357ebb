"""Steps that give the bands their wavelengths, and straighten what the spectrograph bends."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from scanhsi.calibration.conditions import Conditions
from scanhsi.calibration.keystone import Keystone
from scanhsi.calibration.result import Provenance
from scanhsi.calibration.smile import Smile
from scanhsi.calibration.wavelength import Wavelength
from scanhsi.devices.errors import CalibrationError
from scanhsi.processing.functions import Bound, same
from scanhsi.processing.resample import Kind, Mover
from scanhsi.processing.signal import Signal

_FLOAT: Final = np.dtype(np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class AssignWavelength:
    """Give the bands the wavelengths of a calibration; pixels stay as they are.

    Attributes:
        wavelength: Of the cube's region.
        smile: If given, the wavelength of every pixel is stored beside the cube, as ``wavelength_map`` (band, sample): for data
            that is to stay uncorrected.
    """

    wavelength: Wavelength
    smile: Smile | None = None

    @property
    def name(self) -> str:
        """Its name."""
        return "assign wavelength"

    def bind(self, signal: Signal) -> tuple[Signal, Bound]:
        """Same numbers, with wavelengths."""
        _check_fits(signal, self.wavelength.bands, None, self.wavelength.provenance, "wavelength calibration")
        if signal.wavelength_map_nm is not None and self.smile is None:
            signal = replace(signal, wavelength_map_nm=None)
        if self.smile is None:
            return replace(signal, wavelength_nm=self.wavelength.nm()), same
        _check_fits(signal, self.smile.bands, self.smile.samples, self.smile.provenance, "smile calibration")
        pixels = self.smile.wavelength_map(self.wavelength)
        return replace(signal, wavelength_nm=self.wavelength.nm(), wavelength_map_nm=pixels), same

    def describe(self) -> dict[str, Any]:
        """Sources, and the polynomial."""
        smile = {} if self.smile is None else {"smile": list(self.smile.provenance.sources)}
        coefficients = self.wavelength.coefficients.tolist()
        return {"source": list(self.wavelength.provenance.sources), "coefficients_nm": coefficients, **smile}


@dataclass(frozen=True, slots=True, eq=False)
class CorrectSmile:
    """Straighten the smile: every sample gets the wavelengths of the reference sample.

    The one resampling is along the bands. Before binning: bands are what the smile is measured in. Counts keep their sum,
    reflectances their value.

    Attributes:
        smile: Of the cube's region.
        kind: Of interpolation; ``linear`` takes in two bands instead of four, and blurs more.
    """

    smile: Smile
    kind: Kind = "cubic"

    @property
    def name(self) -> str:
        """Its name."""
        return "correct smile"

    def bind(self, signal: Signal) -> tuple[Signal, Bound]:
        """Same shape; nan where a neighbour is nan, and where the light fell beside the sensor."""
        _check_fits(signal, self.smile.bands, self.smile.samples, self.smile.provenance, "smile calibration")
        _check_masked(signal, self.name)
        straight = replace(signal, dtype=_FLOAT, wavelength_map_nm=None)
        return straight, Mover(self.smile.shift(), "band", kind=self.kind, conserve=_is_amount(signal))

    def describe(self) -> dict[str, Any]:
        """Source and kind."""
        return {
            "source": list(self.smile.provenance.sources),
            "kind": self.kind,
            "largest_bands": round(self.smile.largest_bands, 4),
        }


@dataclass(frozen=True, slots=True, eq=False)
class CorrectKeystone:
    """Straighten the keystone: every band sees the place that the middle band sees, by resampling along the slit.

    Attributes:
        keystone: Of the cube's region.
        kind: Of interpolation.
    """

    keystone: Keystone
    kind: Kind = "cubic"

    @property
    def name(self) -> str:
        """Its name."""
        return "correct keystone"

    def bind(self, signal: Signal) -> tuple[Signal, Bound]:
        """Same shape; nan where a neighbour is nan, and where the light fell beside the sensor."""
        _check_fits(
            signal, self.keystone.bands, self.keystone.samples, self.keystone.provenance, "keystone calibration"
        )
        _check_masked(signal, self.name)
        mover = Mover(self.keystone.shift(), "sample", kind=self.kind, conserve=_is_amount(signal))
        return replace(signal, dtype=_FLOAT), mover

    def describe(self) -> dict[str, Any]:
        """Source and kind."""
        return {
            "source": list(self.keystone.provenance.sources),
            "kind": self.kind,
            "largest_samples": round(self.keystone.largest_samples, 4),
        }


def _is_amount(signal: Signal) -> bool:
    """Whether numbers are amounts of light, whose sum is to stay, rather than ratios."""
    return signal.units == "counts"


def _check_masked(signal: Signal, name: str) -> None:
    if signal.saturation is not None:
        raise CalibrationError(
            f"cannot {name} before saturated pixels are masked: they would become plausible numbers.",
            hint="put MaskSaturated first",
        )


def _check_fits(signal: Signal, bands: int, samples: int | None, provenance: Provenance, what: str) -> None:
    if signal.bands != bands or samples not in (None, signal.samples):
        there = f"{bands} bands" if samples is None else f"{bands}x{samples} bands and samples"
        raise CalibrationError(
            f"the {what} is for {there}, not {signal.bands}x{signal.samples}.",
            hint="calibrate with the cube's region, and apply it before any binning",
        )
    region = Conditions(roi=provenance.conditions.roi)  # where light falls does not depend on gain or exposure
    if wrong := signal.conditions.differences(region):
        raise CalibrationError(
            f"the {what} does not apply: {', '.join(wrong)}.", hint="calibrate with the cube's region"
        )
