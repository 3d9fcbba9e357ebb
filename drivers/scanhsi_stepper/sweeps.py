"""Planning a sweep: run-up, constant velocity through all lines, run-out."""

from __future__ import annotations

from dataclasses import dataclass, replace

from scanhsi.devices.capabilities import Sweep
from scanhsi.devices.errors import OutOfRange
from scanhsi.devices.values import Range
from scanhsi_stepper.errors import device_name
from scanhsi_stepper.options import StepperOptions
from scanhsi_stepper.ramp import Profile, move_time_s, run_up_time_s

_SPARE_STEPS = 4  # beyond the ramp, so that the first line is passed at full speed
_COUNT_MAX = 65_535  # of the firmware


@dataclass(frozen=True, slots=True)
class SweepPlan:
    """A sweep as the controller will run it.

    Attributes:
        sweep: With the rate in whole steps/s.
        start: Step at which the run-up begins.
        end: Step at which the run-out ends; with pulses the firmware finds it by itself and may stop some steps before.
        command: For the controller.
        expected_s: How long it takes.
        run_up_s: Time from the command to passing the first line.
    """

    sweep: Sweep
    start: int
    end: int
    command: str
    expected_s: float
    run_up_s: float


def plan_sweep(sweep: Sweep, options: StepperOptions) -> SweepPlan:
    """Work a sweep out.

    Raises:
        OutOfRange: Speed, limits (run-up and run-out included), or pulses that would run into each other.
    """
    device = device_name(options.port)
    Range(1, options.top_speed_steps_s, 0, "steps/s").check("sweep rate", sweep.rate_steps_s, device=device)
    Range(1, _COUNT_MAX, 1).check("number of lines", sweep.count, device=device)
    if sweep.every == 0:
        raise OutOfRange("lines 0 steps apart cannot be swept.", device=device, operation="sweep")
    rate = int(sweep.rate_steps_s)
    profile = Profile(rate, options.acceleration_steps_s2, options.start_speed_steps_s)
    direction = 1 if sweep.every > 0 else -1
    margin = direction * (profile.ramp_steps + _SPARE_STEPS)
    start, end = sweep.first - margin, sweep.last + margin
    limits = Range(options.minimum_step, options.maximum_step, 1, "steps")
    limits.check("start of the sweep's run-up", start, device=device)
    limits.check("end of the sweep's run-out", end, device=device)
    if sweep.pulses and options.trigger_width_us * 1e-6 >= abs(sweep.every) / rate:
        raise OutOfRange(
            f"trigger pulses of {options.trigger_width_us} us every {abs(sweep.every) / rate * 1e6:.0f} us run into each other.",
            device=device,
            operation="sweep",
            hint="lower the rate, or the option trigger_width_us.",
        )
    command = f"W {sweep.first} {sweep.every} {sweep.count} {options.trigger_width_us}" if sweep.pulses else f"MA {end}"
    return SweepPlan(
        replace(sweep, rate_steps_s=float(rate)),
        start,
        end,
        command,
        move_time_s(end - start, profile),
        run_up_time_s(sweep.first - start, profile),
    )
