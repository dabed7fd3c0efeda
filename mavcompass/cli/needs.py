"""What a command needs beyond the program itself, asked for before it begins."""

from __future__ import annotations

from pathlib import Path

from mavcompass.errors import UsageError
from mavcompass.installation.parts import require
from mavcompass.vehicle.transport import Address, Recording, Serial, parse_address


def require_for(
    *sources: str | Path | Address | None, report: Path | bool | None = None, also: tuple[str, ...] = ()
) -> None:
    """Raise UsageError where a part that these sources, a report or `also` need is not installed, or the
    report's folder is not there.

    Args:
        sources: addresses and recordings; None for one that was not given.
        report: the file of a report, or whether there is one.
        also: more keys of `PARTS`.
    """
    needs = [need for source in sources if source is not None and (need := _need_of(source)) is not None]
    if report:
        needs.append("An HTML report")
    require(*dict.fromkeys([*needs, *also]))
    if isinstance(report, Path) and not report.absolute().parent.is_dir():
        raise UsageError(
            f"The report could not be written: the folder of {report} does not exist.",
            "Make it, or name another.",
        )


def _need_of(source: str | Path | Address) -> str | None:
    if isinstance(source, Path):
        source = Recording(source)
    match parse_address(source) if isinstance(source, str) else source:
        case Serial():
            return "A serial port"
    return None
