"""The steps from raw counts to reflectance.

A step is a frozen description. `bind` fits it to a signal, or refuses before any line is touched, and returns the signal that
comes out with a pure function which computes some whole lines, (band, line, sample), from any thread or process. What cannot
be known is nan from where it arises to the end: a saturated pixel never turns into a plausible reflectance.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Final, Protocol

import numpy as np

from scanhsi.calibration.reference import ModelledDark, Reference
from scanhsi.devices.errors import CalibrationError
from scanhsi.processing.functions import Bound, Masked, Means, Scaled, Subtracted, Values, means
from scanhsi.processing.signal import Signal

_FLOAT: Final = np.dtype(np.float32)


class Step(Protocol):
    """One step of a pipeline."""

    @property
    def name(self) -> str:
        """Its name in the provenance."""
        ...

    def bind(self, signal: Signal) -> tuple[Signal, Bound]:
        """Fit the step to a signal: what comes out, and the function that computes it.

        Raises:
            CalibrationError: It does not fit: another sensor region, gain or exposure.
        """
        ...

    def describe(self) -> dict[str, Any]:
        """Its parameters and sources, plain JSON, for the provenance."""
        ...


@dataclass(frozen=True, slots=True)
class MaskSaturated:
    """Counts to float32, saturated pixels to nan.

    Attributes:
        level: Counts from which a pixel is saturated, where the sensor's plateau lies below full scale; None takes the cube's
            largest valid value.
    """

    level: float | None = None

    @property
    def name(self) -> str:
        """Its name."""
        return "mask saturated"

    def bind(self, signal: Signal) -> tuple[Signal, Bound]:
        """Same shape, float32."""
        if signal.units != "counts":
            raise CalibrationError(f"only raw counts saturate; this is {signal.long_name}.")
        level = self.level if self.level is not None else signal.saturation
        return replace(signal, dtype=_FLOAT, saturation=None), Masked(np.inf if level is None else level)

    def describe(self) -> dict[str, Any]:
        """The level."""
        return {"level": self.level}


@dataclass(frozen=True, slots=True, eq=False)
class SubtractDark:
    """Subtract a dark reference taken at the same exposure and gain, or what a dark model says of the exposure."""

    dark: Reference | ModelledDark

    @property
    def name(self) -> str:
        """Its name."""
        return "subtract dark"

    def bind(self, signal: Signal) -> tuple[Signal, Bound]:
        """Same shape, dark-corrected counts."""
        dark = _dark_at(self.dark, signal.conditions.exposure_s)
        _check_fits(dark, signal, "dark reference", exposure=True)
        corrected = replace(signal, dtype=_FLOAT, long_name="dark-corrected counts")
        return corrected, Subtracted(dark.mean)

    def describe(self) -> dict[str, Any]:
        """The reference."""
        return _described(self.dark)


@dataclass(frozen=True, slots=True, eq=False)
class Reflectance:
    """Divide dark-corrected counts by those of a white tile.

    The exposures of cube and tile may differ, since dark-corrected counts are proportional to the exposure.

    Attributes:
        white: The white reference, as the camera gave it.
        dark: Dark reference of the white one's exposure, or a dark model.
        tile: Reflectance of the tile.
    """

    white: Reference
    dark: Reference | ModelledDark
    tile: float = 1.0

    @property
    def name(self) -> str:
        """Its name."""
        return "reflectance"

    def bind(self, signal: Signal) -> tuple[Signal, Bound]:
        """Same shape, a ratio; nan where the tile gave no light."""
        _check_fits(self.white, signal, "white reference", exposure=False)
        dark = _dark_at(self.dark, self.white.conditions.exposure_s)
        _check_fits(dark, signal, "dark reference of the white one", exposure=False)
        if wrong := self.white.conditions.differences(dark.conditions):
            raise CalibrationError(f"{dark.source} is no dark reference for {self.white.source}: {', '.join(wrong)}.")
        if not 0 < self.tile <= 1.5:
            raise CalibrationError(f"a tile cannot have a reflectance of {self.tile:g}.")
        factor = self._factor(signal.conditions.exposure_s, dark)
        return replace(signal, dtype=_FLOAT, units="1", long_name="reflectance"), Scaled(factor)

    def _factor(self, exposure_s: float | None, dark: Reference) -> Values:
        """Reflectance of one dark-corrected count, (band, sample) float32; nan where the tile gave no light."""
        white_s = self.white.conditions.exposure_s
        ratio = white_s / exposure_s if white_s is not None and exposure_s is not None else 1.0
        light = self.white.mean - dark.mean
        return np.divide(_FLOAT.type(self.tile * ratio), light, out=np.full_like(light, np.nan), where=light > 0)

    def describe(self) -> dict[str, Any]:
        """References and tile."""
        return {"white": self.white.describe(), "dark": _described(self.dark), "tile": self.tile}


@dataclass(frozen=True, slots=True)
class BinBands:
    """Mean of neighbouring bands, five rows a channel in the paper; a shorter rest at the end is a channel too.

    A channel with a saturated row is nan.
    """

    rows: int

    @property
    def name(self) -> str:
        """Its name."""
        return "bin bands"

    def bind(self, signal: Signal) -> tuple[Signal, Bound]:
        """Fewer bands; their wavelengths are the means."""
        if not 1 <= self.rows <= signal.bands:
            raise CalibrationError(f"{self.rows} bands cannot be binned into one: there are {signal.bands}.")
        wavelength, pixels = signal.wavelength_nm, signal.wavelength_map_nm
        binned = replace(
            signal,
            bands=-(-signal.bands // self.rows),
            dtype=_FLOAT,
            wavelength_nm=None if wavelength is None else means(self.rows, wavelength),
            wavelength_map_nm=None if pixels is None else means(self.rows, pixels),
        )
        return binned, Means(self.rows)

    def describe(self) -> dict[str, Any]:
        """How many."""
        return {"rows": self.rows}


def _dark_at(dark: Reference | ModelledDark, exposure_s: float | None) -> Reference:
    return dark.at(exposure_s) if isinstance(dark, ModelledDark) else dark


def _described(dark: Reference | ModelledDark) -> dict[str, Any]:
    if isinstance(dark, Reference):
        return dark.describe()
    return {"source": dark.source, "model": "rate * exposure + offset", "frames": dark.model.frames}


def _check_fits(reference: Reference, signal: Signal, what: str, *, exposure: bool) -> None:
    if signal.units != "counts":
        raise CalibrationError(f"a {what} applies to counts; this is {signal.long_name}.")
    shape = (signal.bands, signal.samples)
    if reference.mean.shape != shape:
        there = "x".join(map(str, reference.mean.shape))
        raise CalibrationError(
            f"{reference.source} does not fit as {what}: it has {there} bands and samples, not {shape[0]}x{shape[1]}.",
            hint="take it with the cube's region, before any binning",
        )
    if wrong := signal.conditions.differences(reference.conditions, exposure=exposure):
        raise CalibrationError(
            f"{reference.source} does not fit as {what}: {', '.join(wrong)}.",
            hint="take it under the cube's conditions",
        )
