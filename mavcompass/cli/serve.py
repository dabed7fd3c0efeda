"""`mavcompass serve SOURCE`: the companion-computer service."""

from __future__ import annotations

import json
import logging
import os
import sys
from dataclasses import replace
from pathlib import Path

import click

from mavcompass.cli.needs import require_for
from mavcompass.cli.options import verbose_option
from mavcompass.cli.source import sign_key_option, system_option
from mavcompass.errors import UsageError


@click.command()
@click.argument("source", required=False)
@click.option("--http", "listen", metavar="HOST:PORT", help="Where the page is served [127.0.0.1:8808].")
@click.option(
    "--config",
    "config_file",
    metavar="FILE.toml",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Configuration; what is given here goes before it.",
)
@click.option("--storage", metavar="FOLDER", help="Where history, undo files and reports are kept.")
@click.option("--speed", type=click.FloatRange(0.01, 1000.0), help="Of a simulated vehicle's time [1].")
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
    mavcompass serve --config /etc/mavcompass.toml
    """
    require_for(report=True, also=("The service",))
    from mavcompass.service.config import ServiceConfig, load_config, parse_config
    from mavcompass.service.run import Service

    config = ServiceConfig() if config_file is None else load_config(config_file)
    if source is None and config_file is None:
        raise UsageError("No vehicle was named.", "Give SOURCE, or --config with vehicle.source.")
    # What is given on the command line passes the same checks as what is in a file.
    given: tuple[tuple[str, str, str | float | None], ...] = (
        ("vehicle", "source", source),
        ("vehicle", "speed", speed),
        ("vehicle", "system", system),
        ("http", "listen", listen),
        ("storage", "folder", storage),
    )
    for table, key, value in given:
        if value is not None:
            text = json.dumps(value) if isinstance(value, str) else repr(value)
            checked = parse_config(f"[{table}]\n{key} = {text}\n", "command line")
            changed = {key: getattr(getattr(checked, table), key)}
            config = replace(config, **{table: replace(getattr(config, table), **changed)})
    require_for(config.vehicle.source)
    if not logging.getLogger("mavcompass").isEnabledFor(logging.INFO):
        logging.basicConfig(stream=sys.stderr, format="%(levelname)s: %(message)s")
    service = Service(config)

    def say_ready() -> None:
        print(f"mavcompass serves {config.vehicle.source}")
        print(f"  page       {_page(service.url, service.token, config.token_file)}")
        print(f"  data       {config.folder}")
        if config.is_open_to_the_network:
            print("  The page can be reached from the network; whoever has the token can move the vehicle.")
        sys.stdout.flush()

    service.run(say_ready)
    return 0


def _page(url: str, token: str, token_file: Path) -> str:
    """Spell the page's address; systemd's journal, which more people read than the file, gets no token."""
    in_journal = "JOURNAL_STREAM" in os.environ and not sys.stdout.isatty()
    return f"{url} (token in {token_file})" if in_journal else f"{url}#token={token}"
