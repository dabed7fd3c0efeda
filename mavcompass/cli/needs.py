"""What a command needs beyond the program itself, asked for before it begins."""

from __future__ import annotations

from pathlib import Path

from mavcompass.parts import require
from mavcompass.vehicle.address import Address, Recording, Serial, parse_address


def require_for(
    *sources: str | Path | Address | None, report: Path | bool | None = None, also: tuple[str, ...] = ()
) -> None:
    """Raise UsageError where a part that these sources, a report or `also` need is not installed.

    Args:
        sources: addresses and recordings; None for one that was not given.
        report: the file of a report, or whether there is one.
        also: more keys of `PARTS`.
    """
    needs = [need for source in sources if source is not None and (need := _need_of(source)) is not None]
    if report:
        needs.append("An HTML report")
    require(*dict.fromkeys([*needs, *also]))


def _need_of(source: str | Path | Address) -> str | None:
    if isinstance(source, Path):
        source = Recording(source)
    match parse_address(source) if isinstance(source, str) else source:
        case Serial():
            return "A serial port"
        case Recording(path) if path.suffix.lower() == ".ulg":
            return "A PX4 recording (.ulg)"
    return None
