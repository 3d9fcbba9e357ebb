"""From the stamps of real scans to a delay profile: what each stage of this instrument costs, as it was measured.

A profile keeps both the distribution of each stream by itself and, for replay, the delays of each line, all streams together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from scanhsi.devices.errors import ConfigError
from scanhsi.timing.delays import DelayProfile, Dependence, RecordedScan, Stream, StreamModel
from scanhsi.timing.distributions import AnyDistribution, Constant, Quantile
from scanhsi.timing.observed import Stamps

Ns = NDArray[np.int64]

_ABSENT: Final = np.iinfo(np.int64).min
_NONE: Final = np.int64(-1)
_UNIFORM_KNOTS: Final = 129
_TAIL_KNOTS: Final = 12
_BY_FORMAT: Final = ("T_rx", "T_mcpy")
_LAGS: Final = (1, 2, 5, 20)
_NOTES: Final[dict[Stream, str]] = {
    "T_trig": "mirror there and buffers free, to exposure start, wake-up of the host included",
    "T_ev": "end of the nominal exposure until the next move was commanded (stepped: margin and wake-up of the host included), "
    "else until the end that the driver knows",
    "t1": "exposure end to first byte, where the link was free",
    "T_rx": "first byte (else exposure end) to frame received, less the time the link was busy; of frames as they were sent",
    "T_mcpy": "frame received to copied, less the time the copier was busy",
    "T_act": "command to moved, settle and host disturbance included",
    "T_cmd": "part of T_act: command to the begin of the motion, as early as it can have been",
    "T_rand": "sequential: line before copied, to move commanded; else 0, part of T_ev, T_trig and T_act",
    "T_store": "a line's even share of the commit that stored it, from when its last line is copied and the commit before is over; "
    "not of sequential scans",
}
_WITHIN: Final[dict[Stream, Stream]] = {"T_api": "T_rx", "settle": "T_act"}
"""Not separable by the stamps: counted as 0, because it is in the other."""


@dataclass(frozen=True, slots=True)
class Recording:
    """One scan, as far as its delays go.

    Attributes:
        stamps: Columns of the scan, `scanhsi.cube.records.STAGES`.
        exposure_ns: Exposure time.
        pixel_format: Of its frames.
        steps: Motor steps between lines, either sign.
        mode: ``sequential``, ``stepped`` or ``continuous``.
        run: Which scan it was.
    """

    stamps: Stamps
    exposure_ns: int
    pixel_format: str
    steps: int
    mode: str
    run: str = ""


def measured_ns(recording: Recording) -> dict[Stream, Ns]:
    """Delays of one scan by stream, in ns, int64 (lines,), -1 where a line has none. Streams that no line has are left out."""
    column = recording.stamps
    end, received, copied = column["exposure_end"], column["received"], column["copied"]
    link_free, copier_free = _before(received), _before(copied)
    sent = np.where(column["first_byte"] == _ABSENT, end, column["first_byte"])
    nominal = np.where(column["exposure_start"] == _ABSENT, _ABSENT, column["exposure_start"] + recording.exposure_ns)
    # Stepped, the mirror moves as soon as the host knows that the exposure has ended; with look-ahead it is told before.
    following = np.append(column["commanded"][1:], _ABSENT)
    known = np.where(following == _ABSENT, _ABSENT, np.maximum(following, end)) if recording.mode == "stepped" else end
    idle = (end != _ABSENT) & (link_free <= end)
    found: dict[Stream, Ns] = {
        "T_trig": _delays(_ready(column), column["exposure_start"]),
        "T_ev": _delays(nominal, known),
        "t1": _delays(np.where(idle, end, _ABSENT), column["first_byte"]),
        "T_rx": _delays(np.where(sent == _ABSENT, _ABSENT, np.maximum(sent, link_free)), received),
        "T_mcpy": _delays(np.where(received == _ABSENT, _ABSENT, np.maximum(received, copier_free)), copied),
        "T_act": _delays(column["commanded"], column["moved"]),
        "T_cmd": _delays(column["commanded"], column["started"]),
    }
    if recording.mode == "sequential":
        found["T_rand"] = _delays(_before(copied), column["commanded"])
    else:
        found["T_rand"] = np.where(found["T_act"] >= 0, 0, _NONE)
        # A sequential scan waits until a line is handed over, not until it is stored: storing costs it nothing.
        found["T_store"] = _storing(copied, column["stored"])
    return {stream: delays for stream, delays in found.items() if bool(np.any(delays >= 0))}


def _ready(column: Stamps) -> Ns:
    """When each line could be triggered: the mirror is there, and a buffer free behind it.

    How many buffers there are the stamps tell: as many as were ever in use at a trigger. If there are more, none was waited for.
    """
    trigger, ready = column["trigger"], column["moved"]
    ready = np.where(ready == _ABSENT, trigger, ready)
    for stage in ("copied", "stored"):
        done = np.maximum.accumulate(column[stage])
        line = np.flatnonzero((trigger != _ABSENT) & (done != _ABSENT))
        behind = line - np.searchsorted(done, trigger[line], "right")
        in_use = int(behind.max(initial=-1)) + 1
        if in_use:
            freed = np.concatenate((np.full(in_use, _ABSENT), done))[: len(done)]
            ready = np.where(trigger == _ABSENT, _ABSENT, np.maximum(ready, freed))
    return np.where(trigger == _ABSENT, _ABSENT, np.minimum(ready, trigger))


def _storing(copied: Ns, stored: Ns) -> Ns:
    """Each line's share of its commit: lines that became safe at the same time were written together."""
    shares = np.full(len(stored), _NONE)
    present = np.flatnonzero((stored != _ABSENT) & (copied != _ABSENT))
    if len(present):
        ended, first, commit, lines = np.unique(
            stored[present], return_index=True, return_inverse=True, return_counts=True
        )
        began = np.maximum(np.maximum.reduceat(copied[present], first), np.append(_ABSENT, ended[:-1]))
        shares[present] = (np.maximum(ended - began, 0) // lines)[commit]
    return shares


def _before(ended: Ns) -> Ns:
    """When the stage was done with all lines before, (lines,)."""
    return np.maximum.accumulate(np.concatenate(([_ABSENT], ended)))[:-1]


def _delays(first: Ns, last: Ns) -> Ns:
    both = (first != _ABSENT) & (last != _ABSENT)
    return np.where(both, np.maximum(np.where(both, last, 0) - np.where(both, first, 0), 0), _NONE)


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
    """Autocorrelation over lines, by ranks, averaged over scans; for the length it is summed up to where it is lost in the noise.

    Args:
        scans_ns: Delays of each scan, int64 (n,), at least one in all.
    """
    lines = sum(len(scan) for scan in scans_ns)
    varying = [_ranks(scan) for scan in scans_ns if len(scan) > 2 and np.ptp(scan)]
    if not varying:
        return Dependence(n=lines)
    shortest = min(len(ranks) for ranks in varying)
    acf = {lag: round(_autocorrelation(varying, lag), 4) for lag in _LAGS if lag < shortest / 2}
    length = 1.0
    for lag in range(1, shortest // 2 + 1):
        rho = _autocorrelation(varying, lag)
        if rho < max(0.05, 2 / np.sqrt(lines)):
            break
        length += 2 * rho
    return Dependence(n=lines, acf=acf, length=round(length, 2))


def _ranks(delays_ns: Ns) -> NDArray[np.float64]:
    from scipy import stats  # which takes half a second to import, and is needed here alone

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
        recordings: Its scans; they may differ in exposure, pixel format and length of moves.
        name: Of the profile.
        source: Which scans of which devices.
        mark: How far to trust it.
        readout_s: Read-out as the camera tells it; 0 where it does not.

    Raises:
        ConfigError: No line has a delay.
    """
    measured = [(each, measured_ns(each)) for each in recordings]
    moves = [(abs(each.steps), _present(found["T_act"])) for each, found in measured if "T_act" in found]
    law = step_law(moves) if moves else None
    streams: dict[Stream, StreamModel] = {
        stream: _model(stream, mark, [(each, found[stream]) for each, found in measured if stream in found], law)
        for stream in _NOTES
        if any(stream in found for _, found in measured)
    }
    if not streams:
        raise ConfigError("no line of these scans has two stamps to measure a delay between.")
    for stream, whole in _WITHIN.items():
        if whole in streams:
            streams[stream] = StreamModel(note=f"not separable, part of {whole}", mark=mark, delay=_ZERO)
    if readout_s:
        told = Constant(kind="constant", unit="s", value=readout_s)
        streams["T_rd"] = StreamModel(note="as the camera tells it, not measured", mark="not measured", delay=told)
    scans = tuple(_recorded(each, found) for each, found in measured if found)
    return DelayProfile(schema=1, name=name, source=source, mark=mark, streams=streams, scans=scans)


_ZERO: Final = Constant(kind="constant", unit="ns", value=0)


@dataclass(frozen=True, slots=True)
class StepLaw:
    """What each motor step of a move takes: a straight line through the medians of moves of different length.

    Attributes:
        per_step_ns: Of each step; 0 where moves are of one length, or longer ones take no longer.
        off_ns: By which the median of a length is off that line, at most.
        steps: Lengths of the moves.
    """

    per_step_ns: int
    off_ns: int
    steps: tuple[int, ...]

    def told(self) -> str:
        """In words."""
        lengths = f"motor steps a line: {', '.join(map(str, self.steps))}"
        if len(self.steps) < 2:
            return lengths
        return (
            f"{lengths}; {self.per_step_ns * 1e-6:.4g} ms a step (medians off by at most {self.off_ns * 1e-6:.3g} ms)"
        )


def step_law(moves: Sequence[tuple[int, Ns]]) -> StepLaw:
    """Fit the time per step.

    Args:
        moves: Steps of a move, and how long such moves took in ns, for each scan; one scan at least.
    """
    lengths = sorted({steps for steps, _ in moves})
    by_length = [np.concatenate([took for steps, took in moves if steps == length]) for length in lengths]
    medians = np.array([np.median(took) for took in by_length])
    weights = np.sqrt([len(took) for took in by_length])
    slope = float(np.polyfit(lengths, medians, 1, w=weights)[0]) if len(lengths) > 1 else 0.0
    per_step_ns = max(round(slope), 0)
    rest = medians - per_step_ns * np.array(lengths)
    off = np.abs(rest - np.average(rest, weights=weights**2))
    return StepLaw(per_step_ns, round(float(off.max())), tuple(lengths))


def _recorded(recording: Recording, found: dict[Stream, Ns]) -> RecordedScan:
    return RecordedScan(
        run=recording.run,
        mode=recording.mode,
        pixel_format=recording.pixel_format,
        steps=abs(recording.steps),
        exposure_ns=recording.exposure_ns,
        delays_ns={
            stream: tuple(ns if ns >= 0 else None for ns in column.tolist()) for stream, column in found.items()
        },
    )


def _model(stream: Stream, mark: str, scans: Sequence[tuple[Recording, Ns]], law: StepLaw | None) -> StreamModel:
    note, per_step_ns = _NOTES[stream], 0
    if stream == "T_act" and law is not None:
        note, per_step_ns = f"{note}, {law.told()}", law.per_step_ns
    by_format: dict[str, list[Ns]] = {}
    for recording, column in scans:
        rest = np.maximum(_present(column) - per_step_ns * abs(recording.steps), 0)
        by_format.setdefault(recording.pixel_format if stream in _BY_FORMAT else "", []).append(rest)
    tables = {kind: table(np.concatenate(delays)) for kind, delays in by_format.items()}
    return StreamModel(
        note=note,
        mark=mark,
        delay=tables.get(""),
        by_format={kind: delays for kind, delays in tables.items() if kind},
        per_step=Constant(kind="constant", unit="ns", value=per_step_ns) if per_step_ns else None,
        dependence=dependence([_present(column) for _, column in scans]),
    )


def _present(column: Ns) -> Ns:
    return column[column >= 0]
