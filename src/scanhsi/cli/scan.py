"""``scanhsi scan``."""

from __future__ import annotations

import asyncio
import tomllib
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

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
from scanhsi.cli.codes import ExitCode
from scanhsi.cli.drain import drain_shown
from scanhsi.cli.output import messages, results, write_json
from scanhsi.cli.quantities import limits_of
from scanhsi.cli.real_time import RealTimeOption, parsed_real_time
from scanhsi.cli.resuming import (
    LineRetriesOption,
    OnFaultOption,
    RecoverWithinOption,
    ResumeOption,
    RetriesOption,
    begun_with,
    refuse_with_resume,
)
from scanhsi.cli.storage_options import (
    BinBandsOption,
    BinSamplesOption,
    CodecOption,
    DurabilityOption,
    RawOption,
    SpoolOption,
    storage_settings,
)

if TYPE_CHECKING:
    from scanhsi.clock import RealTime
    from scanhsi.engine import ScanPlan, ScanReport
    from scanhsi.engine.report import Processed
    from scanhsi.instrument import InstrumentConfig
    from scanhsi.processing import LiveProcessing


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(scan)


def scan(
    instrument: Annotated[
        str | None,
        typer.Argument(
            help="Name of a shipped instrument (sensors2019, characterise, twin), or path of an instrument file.",
            show_default="sensors2019",
        ),
    ] = None,
    output: Annotated[
        str | None,
        typer.Option(
            "--output",
            "-o",
            metavar="OUT",
            help="Cube to create: a folder, conventionally *.zarr, or s3://bucket/cube.zarr.",
        ),
    ] = None,
    resume: ResumeOption = None,
    spool: SpoolOption = None,
    discard: Annotated[bool, typer.Option("--discard", help="Store nothing: measure how fast it goes.")] = False,
    mode: Annotated[
        str | None, typer.Option(help="sequential (all in turn), stepped, or continuous (the mirror sweeps).")
    ] = None,
    lines: Annotated[str | None, typer.Option(metavar="N", help="Lines of the cube.")] = None,
    step: Annotated[
        str | None, typer.Option(metavar="STEPS", help="Motor steps between lines; negative scans downwards.")
    ] = None,
    start: Annotated[str | None, typer.Option(metavar="STEP", help="Motor step of the first line.")] = None,
    exposure: Annotated[str | None, typer.Option(metavar="TIME", help='With its unit: "20 ms".')] = None,
    gain: Annotated[str | None, typer.Option(metavar="GAIN", help='With its unit: "3 dB".')] = None,
    pixel_format: Annotated[
        str | None, typer.Option(metavar="FORMAT", help="Mono8, Mono12Packed, Mono12 or Mono16.")
    ] = None,
    period: Annotated[
        str | None,
        typer.Option(metavar="TIME", help="Line period of a continuous scan; default: the shortest safe one."),
    ] = None,
    look_ahead: Annotated[
        str | None,
        typer.Option(
            metavar="P",
            help="Stepped scans: send moves early, accepting this probability (0 to 0.5) that a line is smeared, and flagged.",
        ),
    ] = None,
    on_fault: OnFaultOption = None,
    line_retries: LineRetriesOption = None,
    retries: RetriesOption = None,
    recover_within: RecoverWithinOption = None,
    virtual: Annotated[
        bool, typer.Option("--virtual", help="Run in virtual time: exact, and as fast as it can be computed.")
    ] = False,
    real_time: RealTimeOption = None,
    seed: Annotated[int | None, typer.Option(help="Seed of the simulated devices.")] = None,
    delays: Annotated[
        str | None,
        typer.Option(
            metavar="PROFILE.json",
            help="Delay profile for simulated devices to spend; one from `scanhsi delays record` is replayed.",
        ),
    ] = None,
    codec: CodecOption = None,
    raw: RawOption = False,
    durability: DurabilityOption = None,
    bin_bands: BinBandsOption = None,
    bin_samples: BinSamplesOption = None,
    reflectance: Annotated[
        Path | None,
        typer.Option(
            metavar="OUT",
            help="Cube to be made of the raw one while it is scanned, of what the next options say; see `scanhsi process`.",
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
    average_bands: Annotated[
        int | None, typer.Option(metavar="N", help="With --reflectance: average so many bands into one channel.")
    ] = None,
    max_age: MaxAgeOption = None,
    max_drift: MaxDriftOption = 5.0,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="KEY=VALUE",
            help="Set a key of the instrument file for this scan, as camera.scene=white; repeatable.",
        ),
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print the report as one JSON object.")] = False,
) -> None:
    """Scan a cube. What is not given comes from the instrument file.

    The first Ctrl-C finishes the line and closes the cube, the second cancels the line, too. Ctrl-Z (or SIGUSR1) pauses after the
    line, with the mirror still and the camera disarmed; Ctrl-Z again (or SIGUSR2) goes on.

    [bold]Example[/]: scanhsi scan sensors2019 -o hand.zarr --lines 300 --exposure "20 ms"

    [bold]Example[/]: scanhsi scan -o hand.zarr --reflectance hand-reflectance.zarr --dark dark.nc --white white.nc

    [bold]Example[/]: scanhsi scan --resume hand.zarr --on-fault retry

    [bold]Example[/]: scanhsi scan --virtual --discard --lines 1200 --exposure "100 ms" --mode continuous --json
    """
    from scanhsi import clock
    from scanhsi.imager import default_plan
    from scanhsi.instrument import load_instrument

    if [output is not None, discard, resume is not None].count(True) != 1:
        raise typer.BadParameter(
            "say where the cube goes with -o OUT, or --discard it, or --resume one; one of the three."
        )
    if spool is not None and discard:
        raise typer.BadParameter("nothing is stored with --discard.", param_hint="--spool")
    chain = Chain(dark, white, white_dark, tile, saturation, wavelength, smile, keystone, average_bands)
    process = _live(reflectance, chain)
    options = parsed_real_time(real_time, virtual=virtual)
    storage = storage_settings(codec, raw, durability, bin_bands, bin_samples)
    given = {
        "mode": mode,
        "lines": lines,
        "step": step,
        "start": start,
        "exposure": exposure,
        "gain": gain,
        "pixel_format": pixel_format,
        "period": period,
        "look_ahead": look_ahead,
    }
    faults = {
        "on_fault": on_fault,
        "line_retries": line_retries,
        "retries": retries,
        "recover_within": recover_within,
    }
    recovery = {name: value for name, value in faults.items() if value is not None}
    if resume is not None:
        refuse_with_resume({**given, "seed": seed, "delays": delays, "reflectance": reflectance, **storage})
        config, plan = begun_with(resume, instrument, parsed_settings(settings or ()), recovery)
    else:
        config = load_instrument(instrument or "sensors2019", {**parsed_settings(settings or ()), **storage})
        if seed is not None:
            config = config.with_seed(seed)
        if delays is not None:
            config = config.with_delays(delays)
        plan = default_plan(config, **{name: value for name, value in given.items() if value is not None}, **recovery)
    if virtual:
        refuse_real_devices(config)
    check = None if process is None else partial(chain.check, limits=limits_of(max_age, max_drift))
    work = _scan(config, plan, output or resume, options, spool, process, check, resume=resume is not None)
    report = clock.run(work, virtual=virtual)
    try:
        _finish(report, as_json=json)
    finally:
        if spool is not None:
            drain_shown(spool)


def _live(output: Path | None, chain: Chain) -> LiveProcessing | None:
    """What is to be made beside the scan."""
    if output is None:
        if chain != Chain():
            raise typer.BadParameter("say where the processed cube goes, too: --reflectance OUT.")
        return None
    from scanhsi.processing import LiveProcessing

    return LiveProcessing(chain.steps(), output)


async def _scan(
    config: InstrumentConfig,
    plan: ScanPlan,
    output: str | None,
    options: RealTime,
    spool: Path | None,
    process: LiveProcessing | None,
    check: Callable[[dict[str, Any]], None] | None,
    *,
    resume: bool,
) -> ScanReport:
    from scanhsi.cli.interrupt import interrupts
    from scanhsi.cli.progress import shown
    from scanhsi.devices.errors import ScanFailed
    from scanhsi.imager import open_instrument

    console = messages()
    tell: Callable[[str], None] = partial(console.print, soft_wrap=True)  # a path stays whole, to be copied
    if plan.look_ahead is not None:  # look-ahead accepts smeared lines: say so before, not after
        from scanhsi.cli.summary import accepted_smear

        tell(accepted_smear(plan.look_ahead, plan.lines))
    with interrupts(tell) as interrupt:
        async with open_instrument(config) as imager:
            if check is not None:
                from scanhsi.characterise.protocols.base import attributes_to_be

                check(await attributes_to_be(imager, plan))
            with shown(console) as show:
                interrupt.scanning = True
                control = interrupt.control
                try:
                    if resume and output is not None:
                        return await imager.resume(
                            output, plan, on_progress=show, control=control, real_time=options, spool=spool
                        )
                    return await imager.scan(
                        plan,
                        output,
                        on_progress=show,
                        control=control,
                        real_time=options,
                        spool=spool,
                        process=process,
                    )
                except asyncio.CancelledError:
                    if output is not None:
                        look = f"scanhsi info {output}" if spool is None else f"scanhsi drain {spool}"
                        tell(f"what was stored before is safe: {look}")
                    raise
                except ScanFailed:
                    if spool is not None:
                        tell(f"what was stored waits in the spool, safe: scanhsi drain {spool}")
                    elif output is not None:
                        tell(f"to finish the cube, once the cause is gone: scanhsi scan --resume {output}")
                    raise
                finally:
                    interrupt.scanning = False


def _finish(report: ScanReport, *, as_json: bool) -> None:
    """Tell the report; end with the exit code that it deserves."""
    if as_json:
        write_json(report.to_json())
    else:
        from scanhsi.cli.summary import scan_summary

        results().print(scan_summary(report))
        _tell_processed(report.processed)
    _warn_of_smear(report)
    if report.stopped_early:
        raise typer.Exit(ExitCode.INTERRUPTED)
    if report.missing:
        raise typer.Exit(ExitCode.SCAN_FAILED)
    if report.processed is not None and report.processed.error is not None:
        raise typer.Exit(ExitCode.CUBE)


def _tell_processed(processed: Processed | None) -> None:
    if processed is None:
        return
    if processed.error is not None:
        messages().print(
            f"processing failed, the raw cube is whole: {processed.error}", style="bold red", soft_wrap=True
        )
        return
    behind = (
        f", the last {processed.behind} in {processed.caught_up_s:.1f} s after the scan" if processed.behind else ""
    )
    results().print(f"processed  {processed.output}: {processed.lines} lines{behind}", soft_wrap=True)


def _warn_of_smear(report: ScanReport) -> None:
    from scanhsi.cli.summary import smear_warning

    if report.mode == "continuous" and (warning := smear_warning(report.exposure_s, report.period_s)):
        messages().print(warning, style="yellow")


def parsed_settings(settings: Iterable[str]) -> dict[str, object]:
    """``key=value`` words; values as TOML writes them, anything else as text."""
    values: dict[str, object] = {}
    for setting in settings:
        key, equals, text = setting.partition("=")
        if not equals or not key.strip():
            raise typer.BadParameter(
                f"{setting!r} is not KEY=VALUE, as in geometry.distance='300 mm'.", param_hint="--set"
            )
        try:
            values[key.strip()] = tomllib.loads(f"value = {text}")["value"]
        except tomllib.TOMLDecodeError:
            values[key.strip()] = text.strip()
    return values


def refuse_real_devices(config: InstrumentConfig) -> None:
    """Refuse virtual time for devices that take real time."""
    from scanhsi.devices.errors import ConfigError

    real = [device for device in (config.camera, config.actuator) if not device.backend.virtual_time]
    if real:
        raise ConfigError(
            f"instrument {config.name} cannot run in virtual time:",
            [
                f"{device.role.word}.driver = {device.driver!r} talks to something outside, which takes real time"
                for device in real
            ],
            hint="leave --virtual out, or scan a simulated instrument.",
        )
