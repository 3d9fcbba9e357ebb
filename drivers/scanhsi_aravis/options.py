"""What an instrument file may say about a GigE Vision camera."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field


class AravisOptions(BaseModel):
    """Options of the driver ``aravis``. Durations are seconds, sizes bytes."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    address: str = Field(
        min_length=1,
        description="IP address of the camera (nothing is broadcast then), or its name, id or serial number, which is looked "
        "for on every network interface.",
    )
    packet_size: int | None = Field(
        default=None,
        ge=576,
        le=65535,
        description="Bytes of a stream packet, IP header included. Without it: as much as the network interface takes (its MTU), "
        "at most 9000. Every switch on the way has to pass it.",
    )
    stream_bytes_per_second: int | None = Field(
        default=None,
        gt=0,
        description="Bandwidth that the camera may use (StreamBytesPerSecond). Without it the camera's own setting stays.",
    )
    receive: Literal["auto", "packet-socket", "socket"] = Field(
        default="auto",
        description="How frames are received. `packet-socket` costs a third of the CPU time and needs CAP_NET_RAW; `socket` is "
        "plain UDP, where the first frame after arming may be lost; `auto` takes the packet socket where permitted.",
    )
    socket_buffer: int = Field(
        default=8 << 20,
        ge=65536,
        le=1 << 30,
        description="Receive buffer in bytes of a plain UDP socket; the kernel cuts it to the sysctl net.core.rmem_max.",
    )
    trigger_line: str = Field(
        default="Line1",
        min_length=1,
        description="Input of the camera for hardware triggers, an entry of TriggerSource.",
    )
    exposure_margin_s: float = Field(
        default=0.001,
        ge=0,
        le=1,
        description="The camera tells no end of exposure: it is taken to be this much later than the exposure time after the "
        "camera confirmed the trigger.",
    )
    overlaps_readout: bool = Field(
        default=True,
        description="The sensor can expose the next frame while it reads out the last, as the CMV2000 of a Mako G-223 can. "
        "When false, every exposure waits for the end of read-out.",
    )
    readout_s: float | None = Field(
        default=None,
        gt=0,
        le=10,
        description="Time to read a frame out. Without it: 1 / the highest frame rate that the camera tells at these settings.",
    )
    triggers_in_flight: Literal[1, 2] = Field(
        default=2,
        description="Software triggers whose frame has not arrived. 2: the next exposure overlaps with the transfer of the last "
        "frame, but never with the last exposure. 1: each frame is waited for, for cameras that lose a trigger then.",
    )
    frame_timeout_s: float = Field(
        default=1.0,
        ge=0.05,
        le=3600,
        description="A frame is given up when it is this much later than exposure and read-out explain (free run: three "
        "periods). The camera is then asked whether it is there, which takes up to 2.5 s more when it is not.",
    )
    realtime_priority: int | None = Field(
        default=None,
        ge=1,
        le=99,
        description="SCHED_FIFO priority of the receive thread; needs CAP_SYS_NICE. Off without it.",
    )
    exposure_limits_s: tuple[float, float] | None = Field(
        default=None, description="Allow only these exposure times (shortest, longest), within what the camera allows."
    )
    gain_limits_db: tuple[float, float] | None = Field(
        default=None, description="Allow only these gains (smallest, largest), within what the camera allows."
    )
