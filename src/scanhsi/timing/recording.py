"""From the stamps of real scans to a delay profile: what each stage of this instrument costs, as it was measured.

Streams are marginal: how the delay of one line depends on that of the line before, or of another stage, is told in the notes,
not kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from scanhsi.devices.errors import ConfigError
from scanhsi.timing.delays import DelayProfile, Stream, StreamModel
from scanhsi.timing.distributions import AnyDistribution, Constant, Quantile
from scanhsi.timing.observed import Stamps

Ns = NDArray[np.int64]

_ABSENT: Final = np.iinfo(np.int64).min
_UNIFORM_KNOTS: Final = 129
_TAIL_KNOTS: Final = 12
_BY_FORMAT: Final = ("T_rx", "T_mcpy")
_NOTES: Final[dict[Stream, str]] = {
    "T_trig": "trigger to exposure start",
    "T_ev": "end of the nominal exposure until the next move was commanded (stepped: margin and wake-up of the host included), "
    "else until the end that the driver knows",
    "t1": "exposure end to first byte, where the link was free",
    "T_rx": "first byte (else exposure end) to frame received, less the time the link was busy; of frames as they were sent",
    "T_mcpy": "frame received to copied, less the time the copier was busy",
    "T_act": "command to moved, settle and host disturbance included",
}
_WITHIN: Final[dict[Stream, Stream]] = {"T_api": "T_rx", "T_rand": "T_act", "settle": "T_act"}
"""Not separable by the stamps: counted as 0, because it is in the other."""


@dataclass(frozen=True, slots=True)
class Recording:
    """One scan, as far as its delays go.

    Attributes:
        stamps: Columns of the scan, `scanhsi.cube.records.STAGES`.
        exposure_ns: Exposure time.
        pixel_format: Of its frames.
        steps: Motor steps between lines, either sign.
        stepped: Moves begin as soon as the exposure is known to have ended.
    """

    stamps: Stamps
    exposure_ns: int
    pixel_format: str
    steps: int
    stepped: bool


@dataclass(frozen=True, slots=True)
class Dependence:
    """How much the delays of successive lines have in common.

    Attributes:
        lines: Delays measured.
        acf1: Autocorrelation of their ranks at lag 1.
        independent: How many independent delays they are worth.
    """

    lines: int
    acf1: float
    independent: float


def measured_ns(recording: Recording) -> dict[Stream, Ns]:
    """Delays of one scan by stream, in ns, int64 of shape (lines with both stamps,), in order of lines."""
    column = recording.stamps
    end, received, copied = column["exposure_end"], column["received"], column["copied"]
    link_free, copier_free = _before(received), _before(copied)
    sent = np.where(column["first_byte"] == _ABSENT, end, column["first_byte"])
    nominal = np.where(column["exposure_start"] == _ABSENT, _ABSENT, column["exposure_start"] + recording.exposure_ns)
    known = np.append(column["commanded"][1:], _ABSENT) if recording.stepped else end
    idle = (end != _ABSENT) & (link_free <= end)
    found: dict[Stream, Ns] = {
        "T_trig": _delays(column["trigger"], column["exposure_start"]),
        "T_ev": _delays(nominal, known),
        "t1": _delays(np.where(idle, end, _ABSENT), column["first_byte"]),
        "T_rx": _delays(np.where(sent == _ABSENT, _ABSENT, np.maximum(sent, link_free)), received),
        "T_mcpy": _delays(np.where(received == _ABSENT, _ABSENT, np.maximum(received, copier_free)), copied),
        "T_act": _delays(column["commanded"], column["moved"]),
    }
    return {stream: delays for stream, delays in found.items() if len(delays)}


def _before(ended: Ns) -> Ns:
    """When the stage was done with all lines before, (lines,)."""
    return np.maximum.accumulate(np.concatenate(([_ABSENT], ended)))[:-1]


def _delays(first: Ns, last: Ns) -> Ns:
    both = (first != _ABSENT) & (last != _ABSENT)
    return np.maximum(last[both] - first[both], 0)


def table(delays_ns: Ns) -> AnyDistribution:
    """The distribution of measured delays: quantiles at 129 even knots and at up to 12 in the tail, least and greatest exact.

    Args:
        delays_ns: int64 (n,), n > 0.
    """
    low, high = int(delays_ns.min()), int(delays_ns.max())
    if low == high:
        return Constant(kind="constant", unit="ns", value=low)
    n = len(delays_ns)
    even = np.linspace(0, 1, _UNIFORM_KNOTS) if n >= _UNIFORM_KNOTS else (np.arange(n) + 0.5) / n
    tail = 1 - 0.5 ** np.arange(1, _TAIL_KNOTS + 1) / (_UNIFORM_KNOTS - 1)
    # Each delay has a weight of 1 / n, the greatest too (Hazen): without it the mean of a long tail would be too low.
    p = np.unique(np.concatenate(([0, 0.5 / n], even, tail[tail < 1 - 0.5 / n], [1 - 0.5 / n, 1])))
    q = np.rint(np.quantile(delays_ns, p, method="hazen")).astype(np.int64)
    return Quantile(
        kind="quantile", unit="ns", knots=tuple(zip(p.tolist(), q.tolist(), strict=True)), mean=float(delays_ns.mean())
    )


def dependence(scans_ns: Sequence[Ns]) -> Dependence:
    """Autocorrelation over lines, by ranks, averaged over scans; it is summed up to where it is lost in the noise."""
    lines = sum(len(scan) for scan in scans_ns)
    varying = [_ranks(scan) for scan in scans_ns if len(scan) > 2 and np.ptp(scan)]
    if not varying:
        return Dependence(lines, 0.0, float(lines))
    acf1, time = _autocorrelation(varying, 1), 1.0
    for lag in range(1, min(len(ranks) for ranks in varying) // 2 + 1):
        rho = _autocorrelation(varying, lag)
        if rho < max(0.05, 2 / np.sqrt(lines)):
            break
        time += 2 * rho
    return Dependence(lines, acf1, lines / time)


def _ranks(delays_ns: Ns) -> NDArray[np.float64]:
    ranks: NDArray[np.float64] = stats.rankdata(delays_ns)
    return ranks


def _autocorrelation(scans: Sequence[NDArray[np.float64]], lag: int) -> float:
    centred = [scan - scan.mean() for scan in scans]
    return sum(float(each[:-lag] @ each[lag:]) for each in centred) / sum(float(each @ each) for each in centred)


def profile_of(
    recordings: Sequence[Recording], *, name: str, source: str, mark: str, readout_s: float = 0.0
) -> DelayProfile:
    """The delay profile of an instrument, from scans of it.

    Args:
        recordings: Its scans; they may differ in exposure and pixel format.
        name: Of the profile.
        source: Which scans of which devices.
        mark: How far to trust it.
        readout_s: Read-out as the camera tells it; 0 where it does not.

    Raises:
        ConfigError: Moves of different length, of which one distribution would be wrong; or no line has a delay.
    """
    strides = sorted({abs(each.steps) for each in recordings})
    if len(strides) > 1:
        raise ConfigError(
            f"the scans move by {', '.join(map(str, strides))} steps: record each length of move by itself."
        )
    measured = [(each.pixel_format, measured_ns(each)) for each in recordings]
    streams: dict[Stream, StreamModel] = {}
    for stream, meaning in _NOTES.items():
        by_format: dict[str, list[Ns]] = {}
        for pixel_format, found in measured:
            if stream in found:
                by_format.setdefault(pixel_format if stream in _BY_FORMAT else "", []).append(found[stream])
        if by_format:
            streams[stream] = _model(stream, f"{meaning}{_moves(stream, strides[0])}", mark, by_format)
    if not streams:
        raise ConfigError("no line of these scans has two stamps to measure a delay between.")
    for stream, whole in _WITHIN.items():
        if whole in streams:
            streams[stream] = StreamModel(note=f"not separable, part of {whole}", mark=mark, delay=_ZERO)
    if readout_s:
        told = Constant(kind="constant", unit="s", value=readout_s)
        streams["T_rd"] = StreamModel(note="as the camera tells it, not measured", mark="not measured", delay=told)
    return DelayProfile(schema=1, name=name, source=source, mark=mark, streams=streams)


_ZERO: Final = Constant(kind="constant", unit="ns", value=0)


def _moves(stream: Stream, steps: int) -> str:
    return f", motor steps a line: {steps}" if stream == "T_act" else ""


def _model(stream: Stream, meaning: str, mark: str, by_format: dict[str, list[Ns]]) -> StreamModel:
    tables = {kind: table(np.concatenate(scans)) for kind, scans in by_format.items()}
    note = "; ".join([meaning, *(_told(kind, dependence(scans)) for kind, scans in by_format.items())])
    if stream in _BY_FORMAT:
        return StreamModel(note=note, mark=mark, by_format=tables)
    return StreamModel(note=note, mark=mark, delay=tables[""])


def _told(kind: str, known: Dependence) -> str:
    what = f"{kind}: {known.lines} lines" if kind else f"{known.lines} lines"
    return f"{what}, worth {known.independent:.0f} independent ones (rank autocorrelation {known.acf1:.2f} at lag 1)"
