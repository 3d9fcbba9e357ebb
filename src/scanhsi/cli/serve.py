"""``scanhsi serve``."""

from __future__ import annotations

import ipaddress
import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from scanhsi.cli.output import messages

if TYPE_CHECKING:
    from scanhsi.service.security import Security


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(serve)


def serve(
    instrument: Annotated[
        str,
        typer.Argument(
            help="Name of a shipped instrument (sensors2019, characterise, twin), or path of an instrument file."
        ),
    ] = "sensors2019",
    data: Annotated[
        Path, typer.Option("--data", "-d", metavar="FOLDER", help="Where cubes, results and recipes are kept.")
    ] = Path("scanhsi-data"),
    host: Annotated[str, typer.Option(help="Address to listen on; any but loopback needs a token.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="0 takes a free one.")] = 8080,
    token_file: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            dir_okay=False,
            help="File with the token that everybody has to show; or set SCANHSI_TOKEN. Not on the command line: others see it.",
        ),
    ] = None,
    allow_host: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="A name by which this computer may be called; repeatable."),
    ] = None,
    certificate: Annotated[Path | None, typer.Option(metavar="PEM", help="TLS certificate.", dir_okay=False)] = None,
    key: Annotated[Path | None, typer.Option(metavar="PEM", help="Key of the certificate.", dir_okay=False)] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Set a key of the instrument file, as camera.scene=white."),
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of the simulated devices.")] = None,
) -> None:
    """Operate the instrument from a browser and over REST; needs the extra `web`.

    [bold]Example[/]: scanhsi serve sensors2019 --data cubes
    """
    from scanhsi import clock
    from scanhsi.cli.scan import parsed_settings
    from scanhsi.devices.errors import ConfigError
    from scanhsi.instrument import load_instrument

    try:
        from scanhsi.service.server import Serving, serve
    except ModuleNotFoundError as error:
        if (error.name or "").startswith("scanhsi"):
            raise
        raise ConfigError(f"the service needs {error.name}.", hint="pip install 'scanhsi[web]'") from error
    if (certificate is None) != (key is None):
        raise typer.BadParameter("a certificate and its key go together.", param_hint="--certificate, --key")
    config = load_instrument(instrument, parsed_settings(settings or ()))
    if seed is not None:
        config = config.with_seed(seed)
    security = _security(host, token_file, allow_host or [])
    serving = Serving(host, port, security, certificate, key)
    say = messages().print
    clock.run(serve(config, data, serving, told=lambda url: say(f"listening on {url}", soft_wrap=True)))


def _security(host: str, token_file: Path | None, hosts: list[str]) -> Security:
    from scanhsi.service.security import Security

    token = os.environ.get("SCANHSI_TOKEN") or None
    if token_file is not None:
        try:
            token = token_file.read_text().strip()
        except OSError as error:
            raise typer.BadParameter(f"{token_file}: {error.strerror}", param_hint="--token-file") from error
    if token is not None and len(token) < 16:
        raise typer.BadParameter("a token has 16 characters at least: openssl rand -hex 32", param_hint="--token-file")
    if token is None and not _is_loopback(host):
        raise typer.BadParameter(
            f"{host} is reached from other computers: set a token, with --token-file or SCANHSI_TOKEN.",
            param_hint="--host",
        )
    return Security(token, frozenset(name.lower() for name in hosts))


def _is_loopback(host: str) -> bool:
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
