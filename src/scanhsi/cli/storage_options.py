"""Options of ``scanhsi scan`` about how the cube is stored: settings of the instrument file's ``[storage]`` table."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

CodecOption = Annotated[
    str | None, typer.Option(metavar="CODEC", help="lz4, zstd (smaller, slower), none, or raw. All lossless.")
]
RawOption = Annotated[
    bool, typer.Option("--raw", help="Store uncompressed frames without a copy, for 10GigE: short for --codec raw.")
]
DurabilityOption = Annotated[
    str | None,
    typer.Option(metavar="WHEN", help="When lines survive a power cut: 'every shard', or only 'at close'."),
]
BinBandsOption = Annotated[
    str | None, typer.Option(metavar="N", help="Sum N neighbouring bands before they are stored.")
]
BinSamplesOption = Annotated[
    str | None, typer.Option(metavar="N", help="Sum N neighbouring samples before they are stored.")
]
SpoolOption = Annotated[
    Path | None,
    typer.Option(
        metavar="DIR", help="For OUT in an object store: local folder where what the link cannot carry yet waits, safe."
    ),
]


def storage_settings(
    codec: str | None, raw: bool, durability: str | None, bin_bands: str | None, bin_samples: str | None
) -> dict[str, object]:
    """The settings that were given, by key.

    Raises:
        typer.BadParameter: ``--raw`` with another codec.
    """
    if raw and codec not in (None, "raw"):
        raise typer.BadParameter(f"--raw is a codec of its own, and not {codec}.", param_hint="--raw")
    given: dict[str, object] = {"codec": "raw" if raw else codec, "durability": durability}
    given |= {name: _number(text) for name, text in (("bin_bands", bin_bands), ("bin_samples", bin_samples))}
    return {f"storage.{name}": value for name, value in given.items() if value is not None}


def _number(text: str | None) -> object:
    return int(text) if text is not None and text.lstrip("-").isdigit() else text
