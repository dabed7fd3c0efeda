"""One self-contained HTML file from a template of this room and what it is to show."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path

from mavcompass import __version__
from mavcompass.files import write_text
from mavcompass.installation.parts import require
from mavcompass.printable import figure

_TEMPLATES = Path(__file__).with_name("templates")
# What makes plots answer to hands, and how they look: of the reports and of the service's page.
PLOT_PARTS = (_TEMPLATES / "plot.js", _TEMPLATES / "plot.css")
_SCRIPT = PLOT_PARTS[0].read_text("utf-8")
# Nothing is loaded, and no script runs but ours, whatever a recording's words may hold.
_HASH = base64.b64encode(hashlib.sha256(_SCRIPT.encode()).digest()).decode()
POLICY = (
    f"default-src 'none'; script-src 'sha256-{_HASH}'; style-src 'unsafe-inline'; img-src data:;"
    " base-uri 'none'; form-action 'none'"
)


def write_page(path: Path, template: str, values: Mapping[str, object]) -> None:
    """Fill a template and write the page; everything is escaped but the figures.

    Raises UsageError where the package that does it is not installed or the file cannot be written.
    """
    require("An HTML report")
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(_TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["figure"] = figure
    made = {
        "policy": POLICY,
        "script": _SCRIPT,
        "made_at": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "version": __version__,
    }
    html = environment.get_template(template).render({**values, **made})
    write_text(path, html, "The report")
