"""Under which conditions counts were taken: what a reference or a calibration must share with what it is used on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Self, cast

from scanhsi.devices import PixelFormat

_ALL: Final = ("gain_db", "pixel_format", "roi", "binning")
_NAMES: Final = {
    "exposure_s": "exposure",
    "gain_db": "gain",
    "pixel_format": "pixel format",
    "roi": "region",
    "binning": "binning",
}


@dataclass(frozen=True, slots=True)
class Conditions:
    """How counts were taken, as far as their cube says; None is unknown (an imported cube).

    Attributes:
        exposure_s: Exposure time.
        gain_db: Gain.
        pixel_format: Of the camera.
        roi: Region of the sensor, as the instrument file has it: sizes and offsets.
        binning: Neighbours summed as the cube was stored: ``bands`` and ``samples``.
        temperature_c: Of the sensor.
        taken: When, ISO 8601, UTC.
    """

    exposure_s: float | None = None
    gain_db: float | None = None
    pixel_format: str | None = None
    roi: Mapping[str, int] | None = None
    binning: Mapping[str, int] | None = None
    temperature_c: float | None = None
    taken: str | None = None

    @classmethod
    def of(cls, attributes: Mapping[str, Any]) -> Self:
        """From a cube's attributes."""
        plan = _table(attributes, "plan")
        instrument = _table(attributes, "instrument")
        return cls(
            exposure_s=plan.get("exposure_s"),
            gain_db=plan.get("gain_db"),
            pixel_format=plan.get("pixel_format"),
            roi=instrument.get("roi") or _whole_sensor(attributes, instrument),
            binning=_binning(attributes, plan),
            temperature_c=_temperature(attributes),
            taken=_taken(attributes),
        )

    def differences(
        self, other: Conditions, *, exposure: bool = True, only: tuple[str, ...] | None = None
    ) -> list[str]:
        """What is known of both and not the same, in words: what the other has, instead of what this one has.

        Formats that differ in nothing but how pixels are packed on the link are the same. Temperature and time are not compared:
        they are never the same (`scanhsi.calibration.applies`).

        Args:
            other: Of a reference, say.
            exposure: Whether exposures have to agree.
            only: Fields that matter; gain, format, region and binning by default.
        """
        names = (*(_ALL if only is None else only), *(("exposure_s",) if exposure else ()))
        pairs = [(name, getattr(self, name), getattr(other, name)) for name in names]
        return [
            f"{_NAMES[name]} {_in_words(name, there)} instead of {_in_words(name, here)}"
            for name, here, there in pairs
            if here is not None and there is not None and _same(name, here) != _same(name, there)
        ]


def _in_words(name: str, value: Any) -> str:
    """A value as people write it."""
    match name:
        case "exposure_s":
            return f"{value * 1e3:g} ms"
        case "gain_db":
            return f"{value:g} dB"
        case "roi":
            size = f"{value['samples']} samples x {value['bands']} bands"
            return f"{size} from ({value.get('sample_offset', 0)}, {value.get('band_offset', 0)})"
        case "binning":
            return f"{value['bands']} bands x {value['samples']} samples"
        case _:
            return str(value)


def _same(name: str, value: Any) -> Any:
    """What is compared of a value."""
    if name == "pixel_format" and value in tuple(PixelFormat):
        return PixelFormat(value).bits
    return dict(cast("Mapping[str, int]", value)) if isinstance(value, Mapping) else value


def _table(attributes: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    return cast("Mapping[str, Any]", attributes.get(name) or {})


def _whole_sensor(attributes: Mapping[str, Any], instrument: Mapping[str, Any]) -> Mapping[str, int] | None:
    """The region of an instrument whose file names none."""
    camera = _table(_table(attributes, "devices"), "camera")
    if not instrument or "samples" not in camera or "bands" not in camera:
        return None
    return {"samples": camera["samples"], "bands": camera["bands"], "sample_offset": 0, "band_offset": 0}


def _binning(attributes: Mapping[str, Any], plan: Mapping[str, Any]) -> Mapping[str, int] | None:
    told = _table(attributes, "binning")
    if told:
        return {axis: int(told[axis]) for axis in ("bands", "samples")}
    return {"bands": 1, "samples": 1} if plan else None


def _temperature(attributes: Mapping[str, Any]) -> float | None:
    """As a scan stores it, or as a file that was imported tells it: one a line, perhaps."""
    told = attributes.get("sensor_temperature_c")
    if told is None:
        told = _table(_table(attributes, "imported_from"), "header").get("temperature_degC")
    values = cast("list[float]", told if isinstance(told, list) else [] if told is None else [told])
    return sum(map(float, values)) / len(values) if values else None


def _taken(attributes: Mapping[str, Any]) -> str | None:
    acquisition = _table(attributes, "acquisition")
    return acquisition.get("finished") or acquisition.get("started")
