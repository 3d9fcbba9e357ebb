"""What an instrument file may say about the stepper."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from scanhsi_stepper.ramp import Profile


def _none(value: object) -> object:
    """TOML has no null."""
    return None if value == "none" else value


class StepperOptions(BaseModel):
    """Options of the driver ``stepper``. Steps are microsteps of the mirror."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    port: str = Field(min_length=1, description="Serial port, best its name under /dev/serial/by-id.")
    baud: int = Field(default=115_200, ge=1200, le=1_000_000, description="Baud rate of the firmware.")
    steps_per_revolution: int = Field(default=19_200, ge=1, description="Steps of one turn of the mirror.")
    minimum_step: int = Field(default=-9600, ge=-100_000_000, le=100_000_000, description="Lowest step allowed.")
    maximum_step: int = Field(default=9600, ge=-100_000_000, le=100_000_000, description="Highest step allowed.")
    top_speed_steps_s: int = Field(default=4000, ge=1, le=12_000, description="Highest speed.")
    acceleration_steps_s2: int = Field(default=20_000, ge=10, le=2_000_000, description="Acceleration of ramps.")
    start_speed_steps_s: int = Field(
        default=2000, ge=0, le=4000, description="Speed at which the motor starts and stops without a ramp; 0 = none."
    )
    settle_s: float = Field(
        default=0.015, ge=0, le=10, description="Time the mirror is given to stop ringing after a move."
    )
    backlash_steps: int = Field(
        default=0, ge=0, le=10_000, description="Play of the drive; moves then arrive from below."
    )
    home_direction: Annotated[Literal[-1, 1] | None, BeforeValidator(_none)] = Field(
        default=-1,
        description=(
            'Direction in which the home switch is sought; "none" without a switch: steps then count from where the mirror stood '
            "when the controller started, or was last told to home."
        ),
    )
    home_limit_steps: int = Field(default=21_000, ge=1, le=1_000_000, description="Longest way to the home switch.")
    trigger_width_us: int = Field(default=50, ge=5, le=10_000, description="Width of the trigger pulses of a sweep.")
    reply_timeout_s: float = Field(
        default=0.25, gt=0, le=10, description="Time for one reply before it is asked for again."
    )
    reply_attempts: int = Field(
        default=4,
        ge=1,
        le=100,
        description="How often a request is sent into silence before giving up; damaged ones are sent again at once, as often as "
        "the time of these attempts allows.",
    )
    start_timeout_s: float = Field(
        default=2.5, gt=0, le=60, description="Time for the first answer: opening the port restarts an Arduino."
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

    @property
    def profile(self) -> Profile:
        """Speeds and acceleration of ordinary moves."""
        return Profile(self.top_speed_steps_s, self.acceleration_steps_s2, self.start_speed_steps_s)
