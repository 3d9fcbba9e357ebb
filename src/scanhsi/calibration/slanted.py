"""What a target of parallel slanted lines tells of the mirror: every scan line shows where it lies.

A line that lies off by ``d`` along the scan sees the slanted lines moved along the slit by ``d / slope``: a phase of the wave that
they make along the slit. One scan gives the displacements around its own even motion, for the jitter; scans of the same steps
give those of each from their mean, for repeatability.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, cast

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from scanhsi.devices.errors import CalibrationError

Floats = NDArray[np.float64]
Waves = NDArray[np.complex128]

_PADDING: Final = 16  # of spectra, so that a frequency between two of theirs is found
_STANDS_OUT: Final = 8.0  # times the median of the spectrum
_LEAST_LINES: Final = 16
_LEAST_SAMPLES: Final = 16
_FARTHEST: Final = 0.4  # of a period between the directions: with more, it may as well be less to the other side
_ALIKE: Final = 0.3  # mean resultant of the scans: with less, lines scatter over the whole period


def displacements(lines: NDArray[np.floating], slope: float, sample_pitch_mm: float) -> Floats:
    """Displacement of each scan line along the scan, from a target of parallel slanted lines.

    A line that lies off by ``d`` sees the slanted lines moved along the slit by ``d / slope``. Displacements are told up to half
    the target's period: choose lines some ten times the jitter apart.

    Args:
        lines: (line, sample), one band of the slanted target, evenly scanned.
        slope: Rise of the target's lines along the scan for one unit along the slit: the tangent of 10 degrees, say. The even
            motion of the scan is found from the lines themselves and removed.
        sample_pitch_mm: Distance of the samples.

    Returns:
        (line,) mm, even motion removed.

    Raises:
        CalibrationError: Too few lines, or none of the target to be seen.
    """
    if len(lines) < _LEAST_LINES:
        raise CalibrationError(f"{len(lines)} lines are too few to tell their motion; {_LEAST_LINES} at least.")
    waves, period = _waves([lines])
    wave: Waves = waves[0] / np.abs(waves[0])
    phase = np.angle(wave * np.exp(-1j * _even_motion(wave) * np.arange(len(wave))))
    phase = np.angle(np.exp(1j * (phase - np.angle(np.mean(np.exp(1j * phase))))))
    return -phase * period / (2 * np.pi) * sample_pitch_mm * slope


def repeated_displacements(
    upwards: Sequence[NDArray[np.floating]], downwards: Sequence[NDArray[np.floating]]
) -> tuple[Floats, Floats]:
    """Displacement of each line of each scan from where the mean of all scans sees it.

    Phases are told up to a turn. So the lag of the scans downwards, which is much the same for all lines, is found first, and each
    line is sought around its own direction.

    Args:
        upwards: (line, sample) each, one band of the slanted target, of the same steps in the same order.
        downwards: The same steps, in the same order, approached from above.

    Returns:
        (scan, line) of either, in periods of the target along the scan: positive where a line lies further in the direction in
        which the target's lines rise for growing samples.

    Raises:
        CalibrationError: No lines to be seen, sizes that differ, or displacements too large for the period of the target.
    """
    if len({np.shape(scan) for scan in (*upwards, *downwards)}) != 1:
        raise CalibrationError("the scans differ in lines or samples.", hint="scan the same steps every time")
    wave, _ = _waves([*upwards, *downwards])
    turned = wave / np.abs(wave)
    down = np.arange(len(turned)) >= len(upwards)
    lag = float(np.angle(np.sum(turned[down].mean(axis=0) * np.conj(turned[~down].mean(axis=0)))))
    turned[down] *= np.exp(-1j * lag)
    common = turned.mean(axis=0)
    if abs(lag) > _FARTHEST * 2 * np.pi or float(np.abs(common).mean()) < _ALIKE:
        raise CalibrationError(
            "lines lie almost half a period of the target apart from scan to scan: by how much they do is ambiguous.",
            hint="a target with wider lines",
        )
    phase = np.angle(turned * np.conj(common))
    phase[down] += lag
    phase -= phase.mean(axis=0)
    moved = -phase / (2 * np.pi)
    return moved[~down], moved[down]


def _waves(scans: Sequence[NDArray[np.floating]]) -> tuple[Waves, float]:
    """The wave along the slit in every line, (scan, line), and its period in samples.

    Raises:
        CalibrationError: None stands out.
    """
    values = np.stack([np.asarray(scan, np.float64) for scan in scans])
    if values.ndim != 3 or not values.size or values.shape[2] < _LEAST_SAMPLES or not np.isfinite(values).all():
        raise CalibrationError(
            f"a slanted target needs lines of {_LEAST_SAMPLES} samples at least, all known, not {values.shape[1:]}."
        )
    size = _PADDING * values.shape[2]
    even = (values - values.mean(axis=2, keepdims=True)) * np.hanning(values.shape[2])
    power = np.zeros(size // 2 + 1)
    for line in even.reshape(-1, values.shape[2]):  # one by one: padded, they are many times larger
        power += np.abs(np.fft.rfft(line, size))
    carrier = int(np.argmax(power[2 * _PADDING :])) + 2 * _PADDING
    if np.ptp(values) == 0 or power[carrier] < _STANDS_OUT * np.median(power):
        raise CalibrationError(
            "no pattern of lines stands out along the slit.", hint="is the target in focus, and slanted?"
        )
    sample: Floats = np.arange(values.shape[2], dtype=np.float64)
    return cast("Waves", even @ np.exp(-2j * np.pi * carrier / size * sample)), size / carrier


def _even_motion(wave: NDArray[np.complex128]) -> float:
    """Advance of the phase from one line to the next, rad: where the spectrum of the wave over the lines is highest."""
    size = _PADDING * len(wave)
    best = int(np.argmax(np.abs(np.fft.fft(wave, size))))
    line = np.arange(len(wave))

    def loss(advance: float) -> float:
        return -float(np.abs(np.sum(wave * np.exp(-1j * advance * line))))

    centre, step = 2 * np.pi * best / size, 2 * np.pi / size
    found = cast("Any", optimize.minimize_scalar(loss, bounds=(centre - step, centre + step), method="bounded"))
    return float(found.x)
