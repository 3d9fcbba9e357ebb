"""Delay profiles: what every stage of a line costs, as data, and the delays of each line drawn from them.

A profile is a JSON file. It says where its numbers come from and how far to trust them (`mark`), and everything made
with it must carry that mark. `DelayStreams` draws one delay a line and stream. A draw depends on the seed, the stream
and the *line number* only, never on the order of the calls, so all scan modes (and the analytic bounds) see the very
same delays and differences between them are differences of the modes.
"""

import zlib
from pathlib import Path
from typing import Annotated, Literal, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from scanhsi.devices.errors import ConfigError
from scanhsi.timing.distributions import AnyDistribution, Constant, sample_ns

Stream = Literal[
    "T_trig",  # trigger command to start of exposure
    "T_ev",  # end of exposure until the host knows it
    "T_rd",  # sensor read-out
    "T_dead",  # shortest pause between two overlapped exposures
    "t1",  # end of exposure to the first row on the wire
    "T_rx",  # transfer on the wire
    "T_api",  # camera API and driver, on the link's time
    "T_mcpy",  # unpacking and copying
    "T_act",  # actuator move, serial call and settle
    "T_cmd",  # part of T_act from the command until the mirror begins to move
    "settle",  # settle where it is not part of T_act
    "T_rand",  # disturbance by the host's operating system
    "T_store",  # storing
]
"""Names of the streams (paper eq 1; the read-out and trigger terms are those of the schedule model)."""

BLOCK = 1024
"""Lines whose delays are drawn at once."""
_KEPT_BLOCKS = 4  # bounds the memory of a live view that never ends


class Dependence(BaseModel):
    """How much the delays of successive lines have in common.

    Attributes:
        n: Delays measured.
        acf: Autocorrelation of their ranks within a scan, by lag in lines.
        length: Lines from one delay to the next that is independent of it: n / length is how many independent ones they are worth.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    n: int = Field(ge=1)
    acf: dict[int, float] = {}
    length: float = Field(default=1.0, ge=1)


class StreamModel(BaseModel):
    """The delay of one stage: one distribution, or one for each pixel format, plus a part for each motor step.

    Attributes:
        note: What it is.
        mark: How far to trust it.
        delay, by_format: One of the two.
        per_step: Added for each motor step.
        dependence: Of successive lines, where it was measured.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    note: str
    mark: str
    delay: AnyDistribution | None = None
    by_format: dict[str, AnyDistribution] = {}
    per_step: Constant | None = None
    dependence: Dependence | None = None

    @model_validator(mode="after")
    def _one_way(self) -> "StreamModel":
        if (self.delay is None) == (not self.by_format):
            raise ValueError("give either delay or by_format")
        return self


class RecordedScan(BaseModel):
    """The delays of one scan, line by line.

    Attributes:
        run: Which scan it was.
        mode: How mirror and camera took turns.
        pixel_format: Of its frames.
        steps: Motor steps between lines, not negative.
        exposure_ns: Exposure time.
        delays_ns: For each stream one entry a line, None where the line has no such delay. All of equal length: entries of one
            place belong to one line.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    run: str
    mode: str
    pixel_format: str
    steps: int = Field(ge=0)
    exposure_ns: int = Field(ge=0)
    delays_ns: dict[Stream, tuple[Annotated[int, Field(ge=0)] | None, ...]] = Field(min_length=1, repr=False)

    @model_validator(mode="after")
    def _whole_lines(self) -> "RecordedScan":
        lengths = {len(column) for column in self.delays_ns.values()}
        if len(lengths) > 1 or 0 in lengths:
            raise ValueError(
                f"each stream needs one entry for each line, of which there is one at least, not {lengths}"
            )
        return self

    @property
    def lines(self) -> int:
        """Number of lines."""
        return len(next(iter(self.delays_ns.values())))


class DelayProfile(BaseModel):
    """Delays of an instrument, with their source.

    Attributes:
        streams: The delay of each stage by itself.
        scans: The lines that it was recorded from, if it was.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", populate_by_name=True)

    version: Literal[1] = Field(alias="schema")
    name: str
    source: str
    mark: str
    streams: dict[Stream, StreamModel]
    scans: tuple[RecordedScan, ...] = Field(default=(), repr=False)

    def distribution(self, stream: Stream, pixel_format: str | None = None) -> AnyDistribution | None:
        """Distribution of a stream, None if the profile has none (no delay).

        Raises:
            ConfigError: the stream depends on the pixel format and has none for this one.
        """
        model = self.streams.get(stream)
        if model is None or model.delay is not None:
            return model.delay if model else None
        if pixel_format not in model.by_format:
            known = ", ".join(model.by_format)
            raise ConfigError(f"profile {self.name}: {stream} has no delay for {pixel_format}; it has {known}.")
        return model.by_format[pixel_format]

    def per_step_s(self, stream: Stream) -> float:
        """Seconds that each motor step adds to the stream."""
        model = self.streams.get(stream)
        return model.per_step.mean_s if model and model.per_step else 0.0

    def mean_s(self, stream: Stream, *, pixel_format: str | None = None, steps: int = 0) -> float:
        """Mean delay in seconds for a pixel format and a move of so many steps."""
        distribution = self.distribution(stream, pixel_format)
        return (distribution.mean_s if distribution else 0.0) + abs(steps) * self.per_step_s(stream)


def load_profile(path: Path) -> DelayProfile:
    """Read a delay profile from a JSON file.

    Raises:
        ConfigError: no such file, not JSON, or a key that is missing, unknown or out of range.
    """
    try:
        return DelayProfile.model_validate_json(path.read_bytes())
    except OSError as error:
        raise ConfigError(f"{path}: cannot read the delay profile: {error.strerror or error}") from error
    except ValidationError as error:
        problems = [f"{'.'.join(map(str, e['loc'])) or 'file'}: {e['msg']}" for e in error.errors()]
        raise ConfigError(f"{path} is not a delay profile:", problems) from error


class DelayStreams:
    """The delays of every line, drawn from a profile by (seed, stream, line number)."""

    def __init__(self, profile: DelayProfile, seed: int) -> None:
        if not 0 <= seed < 2**64:
            raise ValueError(f"seed must be an integer from 0 to 2**64 - 1, not {seed}")
        self.profile = profile
        self.seed = seed
        self._blocks: dict[tuple[Stream, str | None], dict[int, list[int]]] = {}
        self._per_step_ns = {stream: round(profile.per_step_s(stream) * 1e9) for stream in get_args(Stream)}

    def delay_ns(self, stream: Stream, line: int, *, pixel_format: str | None = None, steps: int = 0) -> int:
        """Delay of one line in ns.

        Args:
            stream: which stage.
            line: line number, from 0.
            pixel_format: needed where the profile depends on it.
            steps: motor steps moved, either sign.
        """
        number, place = divmod(line, BLOCK)
        blocks = self._blocks.setdefault((stream, pixel_format), {})
        block = blocks.get(number)
        if block is None:
            block = self._draw(stream, pixel_format, number).tolist()
            if len(blocks) == _KEPT_BLOCKS:
                del blocks[next(iter(blocks))]
            blocks[number] = block
        return block[place] + abs(steps) * self._per_step_ns[stream]

    def array_ns(
        self, stream: Stream, lines: int, *, pixel_format: str | None = None, steps: int = 0
    ) -> NDArray[np.int64]:
        """Delays of lines 0 .. lines - 1 in ns, int64 of shape `(lines,)`: the same as `delay_ns` gives one by one."""
        drawn = [self._draw(stream, pixel_format, number) for number in range(-(-lines // BLOCK))]
        delays = np.concatenate([*drawn, np.zeros(0, np.int64)])[:lines]
        return delays + abs(steps) * self._per_step_ns[stream]

    def _draw(self, stream: Stream, pixel_format: str | None, number: int) -> NDArray[np.int64]:
        distribution = self.profile.distribution(stream, pixel_format)
        if distribution is None:
            return np.zeros(BLOCK, dtype=np.int64)
        return sample_ns(distribution, uniforms(self.seed, stream, number, distribution.uniforms))


def uniforms(seed: int, name: str, number: int, columns: int) -> NDArray[np.float64]:
    """Uniforms in [0, 1) for a block of lines, float64 of shape `(BLOCK, columns)`, by seed, name and number of the block."""
    # Raw Philox words: the only part of numpy's random API whose output is promised never to change.
    key = np.array([seed, zlib.crc32(name.encode())], dtype=np.uint64)
    generator = np.random.Philox(key=key, counter=np.array([0, number, 0, 0], dtype=np.uint64))
    words = generator.random_raw(BLOCK * columns)
    return ((words >> np.uint64(11)).astype(np.float64) * 2.0**-53).reshape(BLOCK, columns)
