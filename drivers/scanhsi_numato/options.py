"""What an instrument file may say about a light on a relay."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field


class NumatoOptions(BaseModel):
    """Options of the driver ``numato``."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    port: str = Field(min_length=1, description="Serial port, best its name under /dev/serial/by-id.")
    baud: int = Field(default=19_200, ge=1200, le=1_000_000, description="Baud rate; modules on USB take any.")
    relay: int = Field(default=0, ge=0, le=31, description="Number of the relay on the module, from 0.")
    normally_closed: bool = Field(
        default=False, description="The light hangs on the normally closed contact: the relay switches it off."
    )
    warm_up_s: float = Field(
        default=0.0, ge=0, le=7200, description="Time from switching on until the light is steady; scans wait for it."
    )
    reply_timeout_s: float = Field(
        default=0.5, gt=0, le=10, description="Time for one answer before it is asked again."
    )
    reply_attempts: int = Field(default=3, ge=1, le=100, description="How often a command is sent before giving up.")
    simulated: bool = Field(default=False, description="The port leads to an emulator: cubes are marked as simulated.")
