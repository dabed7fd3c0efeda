"""How `mavcompass params` shows parameters: tables on a terminal, plain lines in a pipe."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping, Sequence

from mavcompass.cli.options import Output
from mavcompass.procedure.dialect import Change
from mavcompass.vehicle.parameters.files import format_value
from mavcompass.vehicle.session import HeldParameters


def show_parameters(output: Output, held: HeldParameters) -> None:
    """Show all parameters: on a terminal one column per compass, in a pipe one NAME VALUE per line."""
    if not _is_table_wanted(output):
        for name, value in held.compass_values.items():
            output.say(f"{name:<16} {_number(value)}")
        return
    compasses = held.compasses
    shared = [(name, _number(v)) for name, v in held.compass_values.items() if held.instance_of(name) is None]
    rows: dict[str, dict[int, str]] = {}
    for name, value in held.compass_values.items():
        instance = held.instance_of(name)
        if instance in compasses:
            rows.setdefault(_quantity(name, instance), {})[instance] = _number(value)
    _table(
        ["", *(f"compass {i}" for i in compasses)],
        [[quantity, *(cells.get(i, "") for i in compasses)] for quantity, cells in rows.items()],
    )
    _table(["of all compasses", "value"], shared)


def show_difference(
    output: Output, held: HeldParameters, differing: Mapping[str, tuple[float | None, float]]
) -> None:
    """Show where a file and the vehicle differ."""
    cells = [
        (name, "absent" if old is None else _number(old), _number(new))
        for name, (old, new) in differing.items()
    ]
    _rows(output, ["parameter", "vehicle", "file"], cells, "{:<16} vehicle {}, file {}")


def show_changes(output: Output, changes: Iterable[Change]) -> None:
    """Show what a write will do."""
    cells = [(c.name, _number(c.old), _number(c.new)) for c in changes]
    _rows(output, ["parameter", "old", "new"], cells, "{:<16} {} -> {}")


def _rows(output: Output, head: Sequence[str], cells: Sequence[Sequence[str]], line: str) -> None:
    """Show cells below their head on a terminal, and as `line` has them in a pipe."""
    if _is_table_wanted(output):
        _table(head, cells)
        return
    for row in cells:
        output.say(line.format(*row))


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    from rich import box
    from rich.console import Console
    from rich.table import Table

    table = Table(*head, box=box.SIMPLE_HEAD)
    for column in table.columns[1:]:
        column.justify = "right"
    for row in rows:
        table.add_row(*row)
    Console().print(table)


def _is_table_wanted(output: Output) -> bool:
    return sys.stdout.isatty() and output.json_file != "-"


def _quantity(name: str, instance: int | None) -> str:
    """Take the compass's number out of a name, so that all compasses share a row."""
    if name.startswith("CAL_MAG"):
        return name[len("CAL_MAG0_") :]
    stem = name.removeprefix(f"COMPASS{instance}_").removeprefix("COMPASS_")
    stem = stem.replace(f"{instance}_", "_").removesuffix(str(instance))
    return {"EXTERN": "EXTERNAL"}.get(stem, stem)


def _number(value: float) -> str:
    return format_value(value) if value == value and abs(value) != float("inf") else str(value)
