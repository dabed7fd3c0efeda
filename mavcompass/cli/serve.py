"""`mavcompass serve SOURCE`: the companion-computer service."""

from __future__ import annotations

import logging
import os
import sys
from dataclasses import replace
from pathlib import Path

import click

from mavcompass.cli.options import FILE, Number, verbose_option
from mavcompass.cli.source import require_for, sign_key_option, system_option
from mavcompass.cli.terminal.lines import wrapped
from mavcompass.errors import UsageError
from mavcompass.installation.parts import params_path


def _print_config(context: click.Context, parameter: click.Parameter, wanted: bool) -> None:
    if wanted:
        click.echo(params_path("service.toml").read_text("utf-8"), nl=False)
        context.exit()


@click.command()
@click.argument("source", required=False)
@click.option("--http", "listen", metavar="HOST:PORT", help="Where the page is served [127.0.0.1:8808].")
@click.option(
    "--config",
    "config_file",
    metavar="FILE.toml",
    type=FILE,
    help="Configuration; what is given here goes before it.",
)
@click.option(
    "--print-config",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_print_config,
    help="Print a configuration with every key and its default.",
)
@click.option("--storage", metavar="FOLDER", help="Where history, undo files and reports are kept.")
@click.option("--speed", type=Number(0.01, 1000.0), help="Of a simulated vehicle's time [1].")
@system_option
@sign_key_option
@verbose_option
def command(
    source: str | None,
    listen: str | None,
    config_file: Path | None,
    storage: str | None,
    speed: float | None,
    system: int | None,
) -> int:
    """Run as a service on a companion computer.

    It keeps the link, publishes the heading with its uncertainty, watches the compass, calibrates and
    checks on request: from the web page, over HTTP, and over MAVLink as component 191.

    \b
    mavcompass serve sim:rover
    mavcompass serve udpin:127.0.0.1:14571 --http 0.0.0.0:8808
    mavcompass serve --print-config > mavcompass.toml
    mavcompass serve --config mavcompass.toml
    """
    require_for(report=True, also=("The service",))
    from mavcompass.service.addresses import page_urls, qr_code
    from mavcompass.service.config import ServiceConfig, load_config
    from mavcompass.service.models import Mistakes, read
    from mavcompass.service.run import Service

    config = ServiceConfig() if config_file is None else load_config(config_file)
    if source is None and config_file is None:
        raise UsageError("No vehicle was named.", "Give SOURCE, or --config with vehicle.source.")
    # What is given on the command line passes the same checks as what is in a file.
    given: tuple[tuple[str, str, str, str | float | None], ...] = (
        ("SOURCE", "vehicle", "source", source),
        ("--speed", "vehicle", "speed", speed),
        ("--system", "vehicle", "system", system),
        ("--http", "http", "listen", listen),
        ("--storage", "storage", "folder", storage),
    )
    for option, table, key, value in given:
        if value is not None:
            there = getattr(config, table)
            try:
                checked = read(type(there), {key: value})
            except Mistakes as wrong:
                raise UsageError(
                    f"{option} {value!r} {wrong.found[0][1]}.", "See --help for examples."
                ) from None
            config = replace(config, **{table: replace(there, **{key: getattr(checked, key)})})
    require_for(config.vehicle.source)
    if not logging.getLogger("mavcompass").isEnabledFor(logging.INFO):
        logging.basicConfig(stream=sys.stderr, format="%(levelname)s: %(message)s")
    service = Service(config)

    def say_ready() -> None:
        print(f"mavcompass serves {config.vehicle.source}")
        key = _key(service.token, config.token_file)
        pages = page_urls(*service.address)
        for number, (url, interface) in enumerate(pages.items()):
            print(
                f"  {'' if number else 'page':4}  {url}{key} {interface if len(pages) > 1 else ''}".rstrip()
            )
        print(f"  data  {config.folder}")
        if config.is_open_to_the_network:
            if sys.stdout.isatty():
                print(*qr_code(f"{service.url}{key}"), sep="\n")
            print(wrapped("Open to this network: whoever has this address can move the vehicle.", sys.stdout))
        else:
            print("Only this computer reaches the page; for phones too: --http 0.0.0.0:8808")
        sys.stdout.flush()

    service.run(say_ready)
    return 0


def _key(token: str, token_file: Path) -> str:
    """Spell what stands behind the page's address; systemd's journal, which many may read, gets no token."""
    in_journal = "JOURNAL_STREAM" in os.environ and not sys.stdout.isatty()
    return f" (token in {token_file})" if in_journal else f"#token={token}"
