"""Read the wanted records of a DataFlash log that was turned into text (.log)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mavcompass.logs.common.chunks import MOST_LINE
from mavcompass.logs.formats.dataflash.record_types import FMT_TYPE, TEXT, Field, Format, Units, make_format
from mavcompass.logs.formats.dataflash.records import DataFlashContents, Log, Records


def read_text_records(path: Path, wanted: Mapping[str, tuple[str, ...]]) -> DataFlashContents:
    """Read the `wanted` records by name, as `read_records` does from a binary log.

    Lines are 'NAME, value, value, ...'; a line that does not fit its format is skipped and counted.
    """
    contents = DataFlashContents()
    reader = _TextReader(contents, wanted)
    with path.open(encoding="utf-8", errors="replace") as file:
        read = 0
        while line := file.readline(MOST_LINE):
            if len(line) == MOST_LINE:  # no text any more: what follows is not searched
                contents.skipped_bytes += path.stat().st_size - read
                contents.skipped_stretches += 1
                break
            read += len(line)
            if not reader.line(line):
                contents.skipped_bytes += len(line)
                contents.skipped_stretches += 1
    reader.finish()
    return contents


class _TextReader:
    def __init__(self, contents: DataFlashContents, wanted: Mapping[str, tuple[str, ...]]) -> None:
        self._contents = contents
        self._wanted = wanted
        self._order = 0
        self._start()

    def _start(self) -> None:
        self._first_order = self._order
        self._formats: dict[str, tuple[Format, list[Field]]] = {}
        self._units = Units()
        self._rows: dict[str, list[tuple[Any, ...]]] = {}
        self._orders: dict[str, list[int]] = {}

    def line(self, line: str) -> bool:
        """Take one line; False where it cannot be understood."""
        name, _, rest = line.strip().partition(",")
        if not name:
            return True
        if name == "FMT":
            return self._format(rest)
        if name not in self._formats:
            return False
        fields = self._formats[name][1]
        # Only the last field may hold commas of its own (a message's text).
        texts = [text.strip() for text in rest.split(",", len(fields) - 1)]
        if len(texts) != len(fields):
            return False
        try:
            values = tuple(
                text if field.character in TEXT else float(text)
                for field, text in zip(fields, texts, strict=True)
            )
            if name in ("UNIT", "MULT", "FMTU"):
                self._note_unit(name, values)
        except (ValueError, OverflowError, IndexError, TypeError):
            return False
        self._order += 1
        counts = self._contents.counts
        counts[name] = counts.get(name, 0) + 1
        if name in self._wanted:
            self._rows.setdefault(name, []).append(values)
            self._orders.setdefault(name, []).append(self._order - 1)
        return True

    def _format(self, rest: str) -> bool:
        parts = [part.strip() for part in rest.split(",")]
        if len(parts) < 5 or not parts[0].isdigit() or not parts[1].isdigit():
            return False
        number, length, name, characters = int(parts[0]), int(parts[1]), parts[2], parts[3]
        some = make_format(number, length, name, characters, parts[4:])
        if some is None:
            return False
        if number == FMT_TYPE and self._formats:
            self.finish()  # another log begins here
            self._start()
        known = self._formats.setdefault(name, (some, list(some.fields.values())))
        return known[0] == some  # a log does not contradict itself: the later one is damaged

    def _note_unit(self, name: str, values: tuple[Any, ...]) -> None:
        if name == "UNIT":
            self._units.labels[chr(int(values[1]))] = str(values[2])
        elif name == "MULT":
            self._units.multipliers[chr(int(values[1]))] = float(values[2])
        else:
            self._units.of_format[int(values[1])] = (str(values[2]), str(values[3]))

    def finish(self) -> None:
        """Append the log read so far to the contents."""
        log = Log(first_order=self._first_order)
        for name, rows in self._rows.items():
            some, fields = self._formats[name]
            wanted = some.names(self._wanted[name])
            kinds = {field.name: "S64" if field.character in TEXT else "f8" for field in fields}
            table = np.empty(len(rows), dtype=[(column, kinds[column]) for column in wanted])
            for field, values in zip(fields, zip(*rows, strict=True), strict=True):
                if field.name in wanted:
                    table[field.name] = [v.encode() if isinstance(v, str) else v for v in values]
            order = np.array(self._orders[name], dtype=np.uint32)
            log.records[name] = Records(table, order, self._units.fields(some), scaled=True)
        if self._formats:
            self._contents.logs.append(log)
