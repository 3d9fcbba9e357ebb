"""What a calibration comes to: numbers with uncertainties, where they come from, and a file that keeps them.

A result is a frozen dataclass whose fields say by `Stored` which dimensions and unit they have; that is all `save` and
`load` need. The file is NetCDF-4, one per result: it opens in xarray, MATLAB, Octave and Panoply alike; nothing in it can run (no
pickle).
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import uuid
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, fields, replace
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any, ClassVar, Protocol, Self, TypeVar, cast, get_type_hints

import numpy as np
import xarray as xr

from scanhsi.calibration.conditions import Conditions
from scanhsi.devices.errors import CalibrationError

SCHEMA = 1
"""Version of the files. Newer ones are refused."""


@dataclass(frozen=True, slots=True)
class Provenance:
    """Where a result comes from.

    Attributes:
        sources: Cubes or tables it was made from.
        conditions: Under which they were taken.
        simulated: Whether any of them is; None where one does not say.
        created: When the result was made, ISO 8601, UTC.
        taken: When its youngest source was taken, ISO 8601, UTC, where known: what its age is counted from.
        temperature_c: Of the sensor, where known.
        version: Of scanhsi.
    """

    sources: tuple[str, ...] = ()
    conditions: Conditions = field(default_factory=Conditions)
    simulated: bool | None = None
    created: str = field(default_factory=lambda: datetime.now(UTC).isoformat(timespec="seconds"))
    taken: str | None = None
    temperature_c: float | None = None
    version: str = field(default_factory=lambda: version("scanhsi"))

    @classmethod
    def of(cls, *datasets: xr.Dataset, names: tuple[str, ...] = ()) -> Self:
        """Of datasets of `scanhsi.open_cube` that were taken under the same conditions, except perhaps the exposure.

        Raises:
            CalibrationError: Gain, format or region differ between them.
        """
        conditions = [Conditions.of(dataset.attrs) for dataset in datasets]
        for other in conditions[1:]:
            if wrong := conditions[0].differences(other, exposure=False):
                raise CalibrationError(f"the cubes were not taken alike: {', '.join(wrong)}.")
        shared = conditions[0] if conditions else Conditions()
        if len({other.exposure_s for other in conditions}) > 1:
            shared = replace(shared, exposure_s=None)
        told = [dataset.attrs.get("simulated") for dataset in datasets]
        warm = [other.temperature_c for other in conditions if other.temperature_c is not None]
        return cls(
            sources=names,
            conditions=replace(shared, temperature_c=None, taken=None),  # they are the result's, here
            simulated=True if True in told else None if None in told else False,
            taken=max((other.taken for other in conditions if other.taken), default=None),
            temperature_c=sum(warm) / len(warm) if warm else None,
        )


@dataclass(frozen=True, slots=True)
class Stored:
    """How a field of a result is kept: ``rate: Annotated[Floats, Stored("counts s-1", "dark current", ("band", "sample"))]``.

    Attributes:
        units: Its unit, ``1`` for none.
        about: What it is, for the file.
        dims: Dimensions of an array; none of a number.
    """

    units: str
    about: str
    dims: tuple[str, ...] = ()


class Result(Protocol):
    """A frozen dataclass with a ``kind``, a `Provenance`, and fields annotated with `Stored`; others are plain JSON."""

    kind: ClassVar[str]
    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def provenance(self) -> Provenance:
        """Where it comes from."""
        ...


R = TypeVar("R", bound=Result)


def _fields(kind: type[Result]) -> dict[str, Stored | None]:
    """The fields of a result but its provenance, with how they are stored."""
    hints = get_type_hints(kind, include_extras=True)
    return {
        item.name: next(
            (extra for extra in getattr(hints[item.name], "__metadata__", ()) if isinstance(extra, Stored)), None
        )
        for item in fields(kind)
        if item.name != "provenance"
    }


def to_dataset(result: Result) -> xr.Dataset:
    """A result as an xarray dataset: arrays are variables, numbers 0-d variables, the rest attributes."""
    variables: dict[str, Any] = {}
    plain: dict[str, Any] = {}
    for name, stored in _fields(type(result)).items():
        value = getattr(result, name)
        if stored is None:
            plain[name] = value
        else:
            variables[name] = (stored.dims, np.asarray(value), {"units": stored.units, "long_name": stored.about})
    provenance = json.dumps(asdict(result.provenance), allow_nan=False)
    head = {
        "scanhsi_calibration": result.kind,
        "schema": SCHEMA,
        "provenance": provenance,
        "settings": json.dumps(plain),
    }
    return xr.Dataset(variables, attrs=head)


def from_dataset(kind: type[R], dataset: xr.Dataset, name: str = "the dataset") -> R:
    """The result that `to_dataset` made a dataset of.

    Raises:
        CalibrationError: It is of another kind, damaged, or was written by a newer scanhsi.
    """
    found = dataset.attrs.get("scanhsi_calibration")
    if found != kind.kind:
        raise CalibrationError(
            f"{name} holds {f'a {found} result' if found else 'no calibration'}, not a {kind.kind} result."
        )
    if int(dataset.attrs["schema"]) > SCHEMA:
        raise CalibrationError(f"{name} was written by a newer scanhsi.", hint="update scanhsi")
    try:
        values: dict[str, Any] = json.loads(dataset.attrs["settings"])
        told = json.loads(dataset.attrs["provenance"])
        for name, stored in _fields(kind).items():
            if stored is not None and name in dataset:  # an older file lacks what was added since, with a default
                value = dataset[name].values
                values[name] = value if stored.dims else value.item()
        told["conditions"] = Conditions(**told["conditions"])
        told["sources"] = tuple(told["sources"])
        build = cast("Callable[..., R]", kind)
        return build(provenance=Provenance(**told), **values)
    except (KeyError, TypeError, ValueError) as error:
        raise CalibrationError(f"{name} is damaged: {error!r}.") from error


def identity(result: Result) -> str:
    """Eight digits that name a result by what it holds and where it comes from, whatever its file is called."""
    dataset = to_dataset(result)
    digest = hashlib.sha256(json.dumps(dataset.attrs, sort_keys=True).encode())
    for name in sorted(map(str, dataset.variables)):
        digest.update(name.encode())
        digest.update(np.ascontiguousarray(dataset[name].values).tobytes())
    return digest.hexdigest()[:8]


def save(result: Result, path: str | Path) -> None:
    """Write a result to a NetCDF-4 file, whole or not at all; an older file of that name is replaced.

    Raises:
        CalibrationError: It cannot be written.
    """
    path = Path(path)
    temporary = path.with_name(f".{path.name}.{uuid.uuid4().hex}.partial")
    try:
        to_dataset(result).to_netcdf(temporary, engine="h5netcdf")
        os.replace(temporary, path)
    except OSError as error:
        raise CalibrationError(f"cannot write {path}: {error.strerror or error}.") from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def unreadable(path: str | Path) -> CalibrationError:
    """What to say of a file that cannot be opened as a result; HDF5's own words are for programmers."""
    if not Path(path).exists():
        return CalibrationError(f"there is no {path}.")
    if not os.access(path, os.R_OK):
        return CalibrationError(f"cannot read {path}: permission denied.")
    return CalibrationError(
        f"cannot read {path}: it is no NetCDF-4 file.",
        hint="a result of `scanhsi calibrate`; a cube is a folder, *.zarr",
    )


def load(kind: type[R], path: str | Path) -> R:
    """Read a result that `save` wrote.

    Raises:
        CalibrationError: The file is missing, or not such a result.
    """
    try:
        with xr.open_dataset(path, engine="h5netcdf") as dataset:
            return from_dataset(kind, dataset.load(), str(path))
    except OSError as error:
        raise unreadable(path) from error
