"""What the options alone tell of a camera's delays: its read-out where given, and the margin of the end of exposure."""

from __future__ import annotations

from scanhsi.timing.delays import DelayProfile, Stream, StreamModel
from scanhsi.timing.devices import DeviceTiming
from scanhsi.timing.distributions import Constant
from scanhsi_aravis.options import AravisOptions


def timing(options: AravisOptions) -> DeviceTiming:
    """The part of the delays that is set, not measured."""
    streams: dict[Stream, StreamModel] = {"T_ev": _set("exposure_margin_s", options.exposure_margin_s)}
    if options.readout_s is not None:
        streams["T_rd"] = _set("readout_s", options.readout_s)
    profile = DelayProfile(
        schema=1, name="aravis", source="Options of the driver.", mark="as set in the instrument file", streams=streams
    )
    return DeviceTiming(
        profile, overlap=options.overlaps_readout, complete=False, packet_size=options.packet_size or 1500
    )


def _set(option: str, value_s: float) -> StreamModel:
    delay = Constant(kind="constant", unit="s", value=value_s)
    return StreamModel(note=f"Option {option}.", mark="as set in the instrument file", delay=delay)
