"""The parameters that a DataFlash log shows, with their times."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from mavcompass.compass_parameters import ardupilot_name
from mavcompass.logs.common import BootClock, Seen
from mavcompass.logs.formats.dataflash.clock import boot_time_s
from mavcompass.logs.formats.dataflash.records import Log, Records

# A compass that learns its offsets in flight changes them with every record.
_MOST_OFFSET_STEPS = 1000


def parameters_seen(logs: Sequence[Log], clock: BootClock) -> list[Seen]:
    """List every PARM of the logs, and the offsets that MAG shows where PARM does not have them."""
    out: list[Seen] = []
    for log in logs:
        records = log.records.get("PARM")
        if records is not None and "Name" in records and "Value" in records:
            out += _values(records, clock)
    names = {one.name for one in out}
    for log in logs:
        for base, kind in enumerate(("MAG", "MAG2", "MAG3"), start=1):
            mag = log.records.get(kind)
            if mag is not None and all(f"Ofs{axis}" in mag for axis in "XYZ"):
                out += _offsets(mag, base, clock, names)
    return out


def _values(records: Records, clock: BootClock) -> Iterator[Seen]:
    boot_s = boot_time_s("PARM", records)
    time_s = clock.from_order(records.order) if boot_s is None else clock.from_boot(records.order, boot_s)
    # At the start of a log all parameters are written; a name that comes again was set.
    power_up = clock.segment(records.order).tolist()
    known: set[tuple[int, bytes]] = set()
    names, values = records.rows["Name"].tolist(), records.rows["Value"].tolist()
    for moment, name, value, number in zip(time_s.tolist(), names, values, power_up, strict=True):
        again = (number, name) in known
        known.add((number, name))
        yield Seen(moment, name.decode("ascii", "replace"), value, announced=again, power_up=number)


def _offsets(mag: Records, base: int, clock: BootClock, names: set[str]) -> Iterator[Seen]:
    """Read offsets off MAG for compasses whose COMPASS_OFS is in no PARM."""
    boot_s = boot_time_s("MAG", mag)
    if boot_s is None:
        return
    numbers = mag.rows["I"] if "I" in mag else np.zeros(len(mag), dtype=np.uint8)
    for number in np.unique(numbers).tolist():
        instance = base + int(number)
        if names & {ardupilot_name("OFS_X", instance), ardupilot_name("OFS_X", instance, "COMPASS2_OFS_X")}:
            continue
        changes = _changes(mag, numbers == number)
        some = mag.select(changes)
        time_s = clock.from_boot(some.order, boot_s[changes])
        power_up = clock.segment(some.order)
        for axis in "XYZ":
            name = ardupilot_name(f"OFS_{axis}", instance)
            offsets = some.quantity(f"Ofs{axis}")
            for moment, value, part in zip(time_s.tolist(), offsets.tolist(), power_up.tolist(), strict=True):
                yield Seen(moment, name, value, True, part)


def _changes(mag: Records, which: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Find the records, among one instance's, where the offsets are others than before."""
    rows = np.flatnonzero(which)
    fresh = np.zeros(rows.size, dtype=bool)
    fresh[:1] = True
    for axis in "XYZ":
        offsets = mag.rows[f"Ofs{axis}"][rows]
        fresh[1:] |= offsets[1:] != offsets[:-1]
    return rows[fresh][:_MOST_OFFSET_STEPS]
