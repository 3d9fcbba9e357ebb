"""``scanhsi process`` and ``scanhsi repack``."""

from __future__ import annotations

import glob
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from scanhsi.cli.chain import (
    Chain,
    DarkOption,
    KeystoneOption,
    MaxAgeOption,
    MaxDriftOption,
    SaturationOption,
    SmileOption,
    TileOption,
    WavelengthOption,
    WhiteDarkOption,
    WhiteOption,
)
from scanhsi.cli.output import messages, results, write_json
from scanhsi.cli.progress import bytes_shown
from scanhsi.cli.quantities import limits_of

if TYPE_CHECKING:
    from scanhsi.cube.shards import Codec
    from scanhsi.processing import Step

_LIKE = "-reflectance"


def register(app: typer.Typer) -> None:
    """Add the commands."""
    app.command()(process)
    app.command()(repack)


def process(
    cubes: Annotated[
        list[str], typer.Argument(metavar="CUBE", help="Raw cubes; a quoted pattern ('runs/*.zarr') names many.")
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="Cube to create; for many cubes the folder to create them in.",
            show_default="beside each",
        ),
    ] = None,
    dark: DarkOption = None,
    white: WhiteOption = None,
    white_dark: WhiteDarkOption = None,
    tile: TileOption = None,
    saturation: SaturationOption = None,
    wavelength: WavelengthOption = None,
    smile: SmileOption = None,
    keystone: KeystoneOption = None,
    bin_bands: Annotated[int | None, typer.Option(help="Average so many bands into one channel.")] = None,
    max_age: MaxAgeOption = None,
    max_drift: MaxDriftOption = 5.0,
    codec: Annotated[Literal["lz4", "zstd", "none", "raw"], typer.Option(help="Of the new cubes.")] = "lz4",
    scheduler: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="dask.distributed cluster that does it: tcp://host:8786.")
    ] = None,
    threads: Annotated[int, typer.Option(min=1, help="Threads here, without a cluster.")] = 2,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with what an interrupted run left.")] = False,
    follow: Annotated[
        bool, typer.Option("--follow", help="Process a cube while it is being written, until it is closed.")
    ] = False,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Make reflectance of raw cubes: dark, white, smile, keystone, binning; saturated pixels become nan.

    Cubes may be larger than memory: they go through shard by shard, on threads or on a cluster. While a cube is being scanned:
    `scanhsi scan --reflectance`, or --follow.

    [bold]Example[/]: scanhsi process hand.zarr --dark dark.zarr --white white.zarr --smile smile.nc --bin-bands 5
    """
    from scanhsi.cube.reader import open_cube
    from scanhsi.processing import process as run

    pairs = _pairs(cubes, output)
    chain = Chain(dark, white, white_dark, tile, saturation, wavelength, smile, keystone, bin_bands)
    steps = chain.steps()
    limits = limits_of(max_age, max_drift)
    for cube, _ in pairs:  # all of them, before the first is begun
        chain.check(open_cube(cube, chunks=None).attrs, limits)
    if follow:
        _follow(pairs, steps, codec, scheduler, resume=resume, as_json=json)
        return
    made: list[dict[str, Any]] = []
    with _cluster(scheduler) as client:
        for cube, target in pairs:
            with bytes_shown(messages(), f"processing {Path(cube).name}:") as progress:
                pipeline = run(
                    cube, target, steps, client=client, threads=threads, codec=codec, resume=resume, progress=progress
                )
            made.append({"cube": cube, "output": str(target), "processing": pipeline.describe()})
    if json:
        write_json({"processed": made})
    else:
        for one in made:
            results().print(f"{one['cube']} -> {one['output']}", soft_wrap=True)


def _follow(
    pairs: list[tuple[str, Path]],
    steps: list[Step],
    codec: Codec,
    scheduler: str | None,
    *,
    resume: bool,
    as_json: bool,
) -> None:
    from dataclasses import asdict

    from scanhsi.processing import follow

    if len(pairs) != 1 or scheduler is not None:
        raise typer.BadParameter("one cube can be followed, here.", param_hint="--follow")
    cube, target = pairs[0]
    messages().print(f"following {cube} until it is closed", soft_wrap=True)
    done = follow(cube, target, steps, codec=codec, resume=resume)
    if as_json:
        write_json({"cube": cube, "output": str(target), **asdict(done)})
    else:
        results().print(
            f"{cube} -> {target}: {done.lines} lines, {done.behind} of them after it was closed", soft_wrap=True
        )


def _pairs(cubes: list[str], output: Path | None) -> list[tuple[str, Path]]:
    """Cubes with what is made of each."""
    found = [name for cube in cubes for name in (sorted(glob.glob(cube)) if glob.has_magic(cube) else [cube])]
    if not found:
        raise typer.BadParameter(f"no cube matches {', '.join(cubes)}.", param_hint="CUBE...")
    names = [_named(cube) for cube in found]
    if len(found) == 1:
        return [(found[0], output or Path(found[0]).with_name(names[0]))]
    if output is not None and not output.is_dir():
        raise typer.BadParameter(f"{len(found)} cubes need a folder; {output} is none.", param_hint="--output")
    if output is not None and len(set(names)) < len(names):
        raise typer.BadParameter("cubes of the same name cannot go into one folder.", param_hint="--output")
    folders = [output or Path(cube).parent for cube in found]
    return [(cube, folder / name) for cube, folder, name in zip(found, folders, names, strict=True)]


def _named(cube: str) -> str:
    path = Path(cube.rstrip("/"))
    return f"{path.stem}{_LIKE}{path.suffix or '.zarr'}"


def _cluster(scheduler: str | None) -> Any:
    if scheduler is None:
        return nullcontext()
    from scanhsi.devices.errors import ConfigError

    try:
        from distributed import Client
    except ImportError as error:
        raise ConfigError("a cluster needs dask.distributed.", hint='pip install "scanhsi[cluster]"') from error
    try:
        return Client(scheduler, timeout="10s")
    except (OSError, ValueError) as error:
        raise ConfigError(
            f"no dask scheduler answers at {scheduler}.", hint="dask scheduler, and its address"
        ) from error


def repack(
    cube: Annotated[Path, typer.Argument(help="Cube to repack.")],
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Cube to create.", show_default="replace the old one when all is verified"),
    ] = None,
    codec: Annotated[Literal["lz4", "zstd", "none", "raw"], typer.Option(help="Of the new cube.")] = "lz4",
    threads: Annotated[int, typer.Option(min=1, help="Threads.")] = 2,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Compress a cube that was written raw, and make it quick to read.

    Every shard is read again and compared before it counts. Interrupted at any time, the same command goes on.

    [bold]Example[/]: scanhsi repack fast.zarr
    """
    from dataclasses import asdict

    from scanhsi.cube.repack import repack as run

    with bytes_shown(messages(), f"repacking {cube.name}:") as progress:
        result = run(cube, output, codec=codec, threads=threads, progress=progress)
    if json:
        write_json(asdict(result))
        return
    ratio = result.bytes_before / max(result.bytes_after, 1)
    before, after = result.bytes_before / 1e6, result.bytes_after / 1e6
    results().print(f"{result.path}: {before:.1f} MB -> {after:.1f} MB ({ratio:.2f} times smaller)", soft_wrap=True)
