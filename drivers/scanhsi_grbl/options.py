"""What an instrument file may say about a GRBL controller. Steps per unit, speed, acceleration and travel are read from it."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

_FARTHEST = 1_000_000  # GRBL computes in 32-bit floats, which tell steps apart up to there and well beyond


class GrblOptions(BaseModel):
    """Options of the driver ``grbl``. Steps are microsteps of the mirror."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    port: str = Field(min_length=1, description="Serial port, best its name under /dev/serial/by-id.")
    baud: int = Field(default=115_200, ge=1200, le=2_000_000, description="Baud rate of the controller.")
    axis: Literal["x", "y", "z"] = Field(default="x", description="Axis whose motor turns the mirror.")
    steps_per_revolution: int = Field(default=19_200, ge=1, description="Steps of one turn of the mirror.")
    minimum_step: int = Field(default=-9600, ge=-_FARTHEST, le=_FARTHEST, description="Lowest step allowed.")
    maximum_step: int = Field(default=9600, ge=-_FARTHEST, le=_FARTHEST, description="Highest step allowed.")
    top_speed_steps_s: float | None = Field(
        default=None, gt=0, description="Highest speed; left out, what the controller allows ($110 to $112)."
    )
    settle_s: float = Field(
        default=0.015, ge=0, le=10, description="Time the mirror is given to stop ringing after a move."
    )
    backlash_steps: int = Field(
        default=0, ge=0, le=10_000, description="Play of the drive; moves then arrive from below."
    )
    home_command: Literal["$H", "$HX", "$HY", "$HZ"] = Field(
        default="$H", description="Starts homing; those of one axis need a build of GRBL that has them."
    )
    home_timeout_s: float = Field(default=60.0, gt=0, le=600, description="Longest that homing may take.")
    poll_s: float = Field(
        default=0.01, ge=0.002, le=1, description="How often it is asked, near the end of a motion, whether it stands."
    )
    reply_timeout_s: float = Field(default=1.0, gt=0, le=60, description="Time for one answer.")
    start_timeout_s: float = Field(
        default=5.0, gt=0, le=60, description="Time for the first answer: opening the port restarts an Arduino."
    )
    motion_margin_s: float = Field(
        default=2.0, gt=0, le=600, description="Added to a motion's computed time as its deadline."
    )
    simulated: bool = Field(default=False, description="The port leads to an emulator: cubes are marked as simulated.")

    @model_validator(mode="after")
    def _limits_in_order(self) -> Self:
        if self.minimum_step >= self.maximum_step:
            raise ValueError(f"minimum_step {self.minimum_step} is not below maximum_step {self.maximum_step}")
        return self
