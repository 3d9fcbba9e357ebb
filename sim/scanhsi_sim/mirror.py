"""Where the mirror looks, against where its motor was sent: jitter, microstepping, a shaft out of true, play of the belt."""

from __future__ import annotations

import math

import numpy as np

from scanhsi_sim.effects import MirrorOptions

_JITTER = 2  # a stream of random numbers of its own


def follow(mirror: float, motor: float, play: float) -> float:
    """Where the mirror is, dragged by a motor with play: exact after a motion upwards, ``play`` too high after one downwards.

    Args:
        mirror: Where it was before.
        motor: Where the motor is now; on the way it did not turn back.
        play: In steps.
    """
    return min(max(mirror, motor), motor + play)


def error_steps(errors: MirrorOptions, place: float, motion: int, seed: int) -> float:
    """Error of the mirror at a place, in steps.

    Args:
        errors: What is wrong with it.
        place: Where it would be without, play included.
        motion: Number of the motion that led there: the jitter is drawn anew for each, and for each microstep of a sweep.
        seed: Of the jitter.
    """
    turn = 2 * math.pi * place
    error = errors.periodic_steps * math.sin(turn / (4 * errors.microsteps))
    phase = math.radians(errors.misalignment_phase_deg)
    error += errors.misalignment_steps * math.cos(turn / errors.misalignment_period_steps + phase)
    if errors.jitter_steps:
        counter = np.array([0, motion, round(place) % 2**64, 0], np.uint64)
        rng = np.random.Generator(np.random.Philox(key=np.array([seed, _JITTER], np.uint64), counter=counter))
        error += errors.jitter_steps * float(rng.standard_normal())
    return error
