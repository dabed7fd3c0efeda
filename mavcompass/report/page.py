"""One self-contained HTML file from a template of this room and what it is to show."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path

from mavcompass import __version__
from mavcompass.errors import UsageError
from mavcompass.installation.parts import require

_TEMPLATES = Path(__file__).with_name("templates")


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
    made = {"made_at": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"), "version": __version__}
    html = environment.get_template(template).render({**values, **made})
    try:
        path.write_text(html, encoding="utf-8")
    except OSError as error:
        raise UsageError(
            f"The report could not be written to {path} ({error.strerror}).",
            "Name a file in a folder that you may write to.",
        ) from error
