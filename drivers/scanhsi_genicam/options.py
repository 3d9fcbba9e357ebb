"""What an instrument file may say about a GenICam camera."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field


class GenicamOptions(BaseModel):
    """Options of the driver ``genicam``. Durations are seconds, sizes bytes."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    address: str = Field(min_length=1, description="IP or MAC address of the camera; it is looked for by a broadcast.")
    interface: str | None = Field(
        default=None,
        description="Network interface that leads to the camera, by name or address. Without it the broadcast goes out on all.",
    )
    discovery_s: float = Field(default=0.5, gt=0, le=10, description="How long the camera has to answer the broadcast.")
    packet_size: int | None = Field(
        default=None,
        ge=576,
        le=65535,
        description="Bytes of a stream packet, IP header included. Without it the camera's own setting stays.",
    )
    exposure_margin_s: float = Field(
        default=0.001,
        ge=0,
        le=1,
        description="The camera tells no end of exposure: it is taken to be this much later than the exposure time after the "
        "camera confirmed the trigger.",
    )
    readout_s: float | None = Field(
        default=None,
        gt=0,
        le=10,
        description="Time to read the whole sensor out. Without it: 1 / the highest frame rate that the camera tells.",
    )
    frame_timeout_s: float = Field(
        default=1.0,
        ge=0.05,
        le=3600,
        description="A frame is given up when it is this much later than exposure and read-out explain.",
    )
    simulated: bool = Field(default=False, description="It is an emulator: cubes are marked as simulated.")
