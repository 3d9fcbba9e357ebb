"""What a cube looks like on disk: arrays, shapes, chunks, attributes.

A cube is one Zarr v3 group::

    cube                (band, line, sample)  uint8, uint16, uint32 (raw counts, or sums of them) or float32, sharded by lines
    wavelength          (band)                nm, where calibrated
    wavelength_map      (band, sample)        nm of every pixel, where the smile was measured and left
    x, y                (sample), (line)      mm in the object plane, where rectified
    time                (line)                wall clock of the start of the exposure
    mirror_step, mirror_angle_rad, frame_id, device_ns, smeared, attempt, run, commanded_ns ... stored_ns     (line)
    status              (line)                0 nothing safe here, 1 stored, 2 missing
    quicklook           (channel, quicklook_line, quicklook_sample)    where asked for: a picture at an eighth of the size

Every array is created at its planned length and one shard holds whole lines (all bands, all samples), so that a shard is written
once, whole, and a line is never spread over two files. Within a shard, inner chunks keep a band image, a spectrum and a line all
cheap to read. The per-line arrays have one chunk a shard, so each chunk of ``status`` vouches for exactly one shard.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np
from numpy.typing import DTypeLike, NDArray

from scanhsi.cube.binning import NO_BINNING, Binning, sum_type
from scanhsi.cube.quicklook import QuicklookSpec
from scanhsi.cube.records import NOT_STAMPED, STAGES, LineStatus

FORMAT: Final = 1
"""Version of this layout, in the root attribute ``scanhsi_format``. Readers refuse newer ones."""

DIMENSIONS: Final = ("band", "line", "sample")

_SHARD_BYTES: Final = 48_000_000
"""A shard of raw pixels this big is fast to write and to read, and three of them are the writer's memory."""

_RAW_SHARD_BYTES: Final = 96_000_000
"""Of raw mode, which needs no other memory: what a shard costs besides its pixels, some ten ms for the syncs of its records, must
be little beside the time that a fast disk takes for it."""

_DTYPES: Final = tuple(np.dtype(kind) for kind in (np.uint8, np.uint16, np.uint32, np.float32))

_MAX_SHARD_LINES: Final = 64
_MIN_SHARD_LINES: Final = 16
_CHUNK_SAMPLES: Final = 448
_RESERVED: Final = frozenset(
    {
        "Conventions",
        "ome",
        "scanhsi_format",
        "complete",
        "missing",
        "incidents",
        "clock_offset_ns",
        "acquisition",
        "storage",
        "binning",
        "resumed",
    }
)


@dataclass(frozen=True, slots=True, eq=False)
class Coordinate:
    """An array that says where pixels are: ``x`` and ``y`` of a rectified cube, the wavelength of every pixel.

    Attributes:
        name: Of the array.
        dims: Its dimensions, of `DIMENSIONS`.
        values: As long along each as the cube.
        attributes: CF-style, plain JSON.
    """

    name: str
    dims: tuple[str, ...]
    values: NDArray[Any]
    attributes: Mapping[str, Any]


@dataclass(frozen=True, slots=True, eq=False)
class CubeSpec:
    """What is going to be stored.

    Args:
        lines: Planned lines.
        bands: Rows of a frame, as the camera sends it.
        samples: Pixels along the slit, as the camera sends them.
        dtype: Of the camera's pixels: uint8 or uint16; float32 for what is no count any more (reflectance, radiance).
        significant_bits: Of a pixel: 8, 12, 16; None for float32. Values are never scaled.
        attributes: What the cube says about itself, plain JSON: ``plan``, ``instrument``, ``devices``, ``versions``, ``simulated``.
        wavelength_nm: (bands,) float64 where calibrated.
        pixel_attributes: What the pixels are, instead of raw counts: ``long_name``, ``units``.
        binning: Neighbours summed before they are stored; `stored` is what becomes of the rest.
        quicklook: Picture to be written beside the cube; None for none.
        coordinates: Arrays written with the empty cube, besides ``wavelength``.

    Raises:
        ValueError: Sizes, dtype, attributes or wavelengths that cannot be a cube.
    """

    lines: int
    bands: int
    samples: int
    dtype: DTypeLike
    significant_bits: int | None
    attributes: Mapping[str, Any] = field(default_factory=dict[str, Any])
    wavelength_nm: NDArray[np.float64] | None = None
    pixel_attributes: Mapping[str, str] = field(default_factory=dict[str, str])
    binning: Binning = NO_BINNING
    quicklook: QuicklookSpec | None = None
    coordinates: tuple[Coordinate, ...] = ()

    def __post_init__(self) -> None:
        if min(self.lines, self.bands, self.samples) < 1:
            raise ValueError(f"a cube needs at least one line, band and sample, not {self.shape}")
        dtype, bits = np.dtype(self.dtype), self.significant_bits
        if dtype.newbyteorder("=") not in _DTYPES:
            raise ValueError(f"a cube holds uint8, uint16, uint32 or float32, not {dtype}")
        if bits is not None if dtype.kind == "f" else bits is None or not 1 <= bits <= 8 * dtype.itemsize:
            raise ValueError(f"{dtype} cannot have {bits} significant bits")
        if self.wavelength_nm is not None and np.shape(self.wavelength_nm) != (self.bands,):
            raise ValueError(f"wavelength_nm must have shape ({self.bands},), not {np.shape(self.wavelength_nm)}")
        if taken := _RESERVED & set(self.attributes):
            raise ValueError(f"attributes {sorted(taken)} are written by the cube itself")
        if self.binning.bands > self.bands or self.binning.samples > self.samples:
            raise ValueError(f"bins of {self.binning.bands} bands and {self.binning.samples} samples exceed the frame")
        if self.binning.factor > 1 and bits is None:
            raise ValueError("binning sums counts; float32 is none")
        if self.quicklook is not None and self.quicklook.weights.shape != (len(self.quicklook.channels), self.bands):
            raise ValueError(f"quicklook weights must have shape ({len(self.quicklook.channels)}, {self.bands})")
        sizes: dict[str, int] = dict(zip(DIMENSIONS, self.shape, strict=True))
        for coordinate in self.coordinates:
            if coordinate.values.shape != tuple(sizes.get(name) for name in coordinate.dims):
                raise ValueError(f"coordinate {coordinate.name} does not fit a cube of {self.shape}")
        if self.binning.factor > 1 and self.coordinates:
            raise ValueError("a cube that is binned as it is written has no coordinates but wavelengths")
        json.dumps(dict(self.attributes), allow_nan=False)  # refuse now what could not be stored later

    @property
    def shape(self) -> tuple[int, int, int]:
        """(bands, lines, samples)."""
        return (self.bands, self.lines, self.samples)

    @property
    def stored(self) -> CubeSpec:
        """What is on disk: this, after binning. A wavelength is the mean of its bands; a rest that fills no bin is dropped.

        Raises:
            ValueError: The sums do not fit 32 bits.
        """
        if self.binning.factor == 1:
            return self
        assert self.significant_bits is not None
        bands, samples = self.bands // self.binning.bands, self.samples // self.binning.samples
        largest = (2**self.significant_bits - 1) * self.binning.factor
        wavelength = self.wavelength_nm
        if wavelength is not None:
            grouped = np.asarray(wavelength, np.float64)[: bands * self.binning.bands]
            wavelength = grouped.reshape(bands, self.binning.bands).mean(axis=1)
        return replace(
            self,
            bands=bands,
            samples=samples,
            dtype=sum_type(largest),
            significant_bits=largest.bit_length(),
            wavelength_nm=wavelength,
            pixel_attributes={"long_name": f"sums of {self.binning.factor} raw camera counts", **self.pixel_attributes},
            binning=NO_BINNING,
            quicklook=None,
        )

    @property
    def line_bytes(self) -> int:
        """Raw size of one line, as the camera sends it."""
        return self.bands * self.samples * np.dtype(self.dtype).itemsize


@dataclass(frozen=True, slots=True)
class Layout:
    """Shapes of the pieces of the ``cube`` array, (band, line, sample) each.

    Attributes:
        shard: One file. Whole lines; bands and samples rounded up to multiples of the inner chunk, as the format wants it.
        chunk: What is compressed, and read, at once.
    """

    shard: tuple[int, int, int]
    chunk: tuple[int, int, int]

    @property
    def lines_per_shard(self) -> int:
        """Lines that become safe together."""
        return self.shard[1]


def choose_layout(spec: CubeSpec, lines_per_shard: int | None = None, *, whole_frames: bool = False) -> Layout:
    """Shard and inner chunk for a stream of frames.

    The writer holds a few shards in memory and a line is safe only once its shard is: big lines get 16 lines a shard, small ones
    more, so that files and inner chunks do not become tiny. Inner chunks hold 0.2 to 1 MB, which is where reading a band,
    a spectrum and a line cost about the same.

    Args:
        spec: The cube, before binning: it is frames as the camera sends them that are in memory.
        lines_per_shard: Instead of the rule: fewer for slow scans that should be safe sooner, more for fewer files.
        whole_frames: Inner chunks are frames, as raw mode writes them: quick to write, slow to read a band from.
    """
    if lines_per_shard is None:
        budget = _RAW_SHARD_BYTES if whole_frames else _SHARD_BYTES
        lines_per_shard = _MIN_SHARD_LINES
        while lines_per_shard < _MAX_SHARD_LINES and 2 * lines_per_shard * spec.line_bytes <= budget:
            lines_per_shard *= 2
        lines_per_shard = min(lines_per_shard, spec.lines)
    if lines_per_shard < 1:
        raise ValueError(f"lines_per_shard must be at least 1, not {lines_per_shard}")
    stored = spec.stored
    if whole_frames:
        return Layout((stored.bands, lines_per_shard, stored.samples), (stored.bands, 1, stored.samples))
    inner_lines = lines_per_shard
    while inner_lines > 32 and inner_lines % 2 == 0:
        inner_lines //= 2
    bands = _split(stored.bands, 32 if inner_lines <= 16 else 16)
    samples = _split(stored.samples, _CHUNK_SAMPLES)
    shard = (_round_up(stored.bands, bands), lines_per_shard, _round_up(stored.samples, samples))
    return Layout(shard, (bands, inner_lines, samples))


def _split(length: int, target: int) -> int:
    """A piece near ``target`` that divides ``length``, or else leaves little padding."""
    if length <= target:
        return length
    divisors = [piece for piece in range(target * 5 // 8, target * 3 // 2 + 1) if length % piece == 0]
    if divisors:
        return min(divisors, key=lambda piece: abs(piece - target))
    return -(-length // round(length / target))


def _round_up(length: int, piece: int) -> int:
    return -(-length // piece) * piece


@dataclass(frozen=True, slots=True)
class LineVariable:
    """One per-line array: its name, type, value where nothing was written, and attributes."""

    name: str
    dtype: str
    fill: int | float
    attributes: Mapping[str, Any]


def _stamp(stage: str) -> LineVariable:
    text = {"long_name": f"{stage.replace('_', ' ')}, loop clock", "units": "ns", "not_stamped": NOT_STAMPED}
    return LineVariable(f"{stage}_ns", "int64", NOT_STAMPED, text)


# "ns" on purpose, never "nanoseconds": xarray would decode that into timedelta64 on the way in.
RECORDS: Final = (
    LineVariable(
        "time",
        "int64",
        NOT_STAMPED,
        {
            "standard_name": "time",
            "long_name": "start of exposure, wall clock",
            "units": "nanoseconds since 1970-01-01T00:00:00Z",
            "calendar": "proleptic_gregorian",
            "_FillValue": NOT_STAMPED,
        },
    ),
    LineVariable("mirror_step", "int64", 0, {"long_name": "mirror position", "units": "steps"}),
    LineVariable(
        "mirror_angle_rad", "float64", float("nan"), {"long_name": "mirror angle from the normal", "units": "rad"}
    ),
    LineVariable("frame_id", "int64", -1, {"long_name": "frame number of the camera", "none": -1}),
    LineVariable(
        "device_ns",
        "int64",
        NOT_STAMPED,
        {"long_name": "camera clock, its own epoch", "units": "ns", "not_stamped": NOT_STAMPED},
    ),
    LineVariable(
        "smeared",
        "uint8",
        0,
        {
            "long_name": "mirror moved before the exposure had ended",
            "flag_values": [0, 1],
            "flag_meanings": "still smeared",
        },
    ),
    LineVariable("attempt", "uint16", 0, {"long_name": "how often the line was tried"}),
    LineVariable(
        "run", "uint16", 0, {"long_name": "session that took the line: 0 began the cube, n is the n-th that resumed it"}
    ),
    *(_stamp(stage) for stage in STAGES),
)
"""Per-line arrays but ``status``, which is written after them."""

STATUS: Final = LineVariable(
    "status",
    "uint8",
    int(LineStatus.NOT_STORED),
    {
        "long_name": "what became of the line",
        "flag_values": [int(status) for status in LineStatus],
        "flag_meanings": " ".join(status.name.lower() for status in LineStatus),
    },
)


def cube_attributes(spec: CubeSpec) -> dict[str, Any]:
    """CF-style attributes of the ``cube`` array, with its coordinates by name."""
    coordinates = [variable.name for variable in (*RECORDS, STATUS)]
    if spec.wavelength_nm is not None:
        coordinates.insert(0, "wavelength")
    coordinates += [coordinate.name for coordinate in spec.coordinates]
    names = {"long_name": "raw camera counts", "units": "1", "coordinates": " ".join(coordinates)}
    if spec.significant_bits is None:
        return {**names, "long_name": "pixel values", **spec.pixel_attributes}
    valid = {"valid_min": 0, "valid_max": 2**spec.significant_bits - 1, "significant_bits": spec.significant_bits}
    return {**names, **valid, **spec.pixel_attributes}


WAVELENGTH_ATTRIBUTES: Final = {
    "standard_name": "radiation_wavelength",
    "long_name": "centre wavelength of the band",
    "units": "nm",
}

WAVELENGTH_MAP_ATTRIBUTES: Final = {
    "standard_name": "radiation_wavelength",
    "long_name": "wavelength of the pixel, smile included",
    "units": "nm",
}
