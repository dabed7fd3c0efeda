"""Read ArduPilot's own log (DataFlash, .bin or text .log) into a Track."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavcompass.compass_parameters import ardupilot_name
from mavcompass.errors import BadRecording, NoMagnetometer
from mavcompass.logs.common.boot_clock import BootClock
from mavcompass.logs.common.chunks import damage
from mavcompass.logs.common.parameter_steps import Change, Seen, ardupilot_steps, changes, unknown_correction
from mavcompass.logs.common.samples import spoken, texts_said
from mavcompass.logs.formats.dataflash.columns import (
    boot_time_s,
    clock_of,
    columns,
    leave_out_impossible_times,
    take,
)
from mavcompass.logs.formats.dataflash.records import DataFlashContents, Log, Records, read_records
from mavcompass.logs.formats.dataflash.text import read_text_records
from mavcompass.track import MagSeries, Track

_TIME = ("TimeUS", "TimeMS")
_MAG = (*_TIME, "I", "MagX", "MagY", "MagZ", "OfsX", "OfsY", "OfsZ")
_IMU = (*_TIME, "I", "GyrX", "GyrY", "GyrZ", "AccX", "AccY", "AccZ", "T", "Temp")
_OUTPUTS = tuple(f"{stem}{n}" for stem in ("C", "Ch", "Chan") for n in range(1, 9))
WANTED: dict[str, tuple[str, ...]] = {
    "MAG": _MAG,
    "MAG2": _MAG,
    "MAG3": _MAG,
    "IMU": _IMU,
    "ATT": (*_TIME, "Roll", "Pitch", "Yaw"),
    "GPS": (
        *("TimeUS", "TimeMS", "T", "I", "Status", "GMS", "GWk", "Week"),
        *("Lat", "Lng", "Alt", "Spd", "GCrs", "VZ", "Yaw"),
    ),
    "POS": (*_TIME, "Lat", "Lng", "Alt"),
    "XKF1": (*_TIME, "C", "PN", "PE", "PD"),
    "NKF1": (*_TIME, "C", "PN", "PE", "PD"),
    "BAT": (*_TIME, "I", "Inst", "Instance", "Volt", "Curr"),
    "CURR": (*_TIME, "I", "Inst", "Instance", "Volt", "Curr"),
    "CTUN": (*_TIME, "ThO", "ThrOut"),
    "THR": (*_TIME, "ThrOut"),
    "BARO": (*_TIME, "I", "Temp"),
    "RCOU": (*_TIME, *_OUTPUTS),
    "SIM": (*_TIME, "Roll", "Pitch", "Yaw", "Q1", "Q2", "Q3", "Q4"),
    "PARM": (*_TIME, "Name", "Value"),
    "MSG": (*_TIME, "Message"),
}
_FIRMWARES = (("Rover", "rover"), ("Copter", "copter"), ("Sub", "sub"), ("Plane", "plane"))
_BOAT = 2  # FRAME_CLASS
# A compass that learns its offsets in flight changes them with every record.
_MOST_OFFSET_STEPS = 1000


def read_dataflash(path: Path, *, text: bool = False) -> Track:
    """Read a DataFlash log, or several that were put together.

    Raises BadRecording where it holds no record or no magnetometer.
    """
    contents = (read_text_records if text else read_records)(path, WANTED)
    if not contents.counts:
        raise BadRecording(
            f"{path} holds no DataFlash record: it is not ArduPilot's log, or wholly damaged.",
            "Give the .bin as it comes from the autopilot's card.",
        )
    logs = contents.logs
    logged = any(name in log.records for log in logs for name in ("MAG", "MAG2", "MAG3"))
    notes = _notes_about_the_file(contents)
    glitches = leave_out_impossible_times(logs)
    clock = clock_of(logs)
    if glitches:
        notes.append(f"Left out {glitches} records with an impossible time.")
    notes += clock.restarts()
    history = changes(parameters_seen(logs, clock), clock.start_s.tolist())
    parameters = {change.name: change.value for change in history}
    compasses, silences = _compasses(logs, clock, history)
    notes += silences
    notes += [unknown_correction(i) for i, compass in compasses.items() if not compass.correction_known]
    if not compasses:
        if logged:
            raise NoMagnetometer(
                f"{path} holds only zeros as magnetic field: there was no compass.",
                "Check the compass's wiring and COMPASS_ENABLE, and record again.",
                parameters,
            )
        raise NoMagnetometer(
            f"{path} holds no magnetometer: {sum(contents.counts.values())} records, but no MAG.",
            "Set LOG_BITMASK to include the compass, check that COMPASS_ENABLE is 1, and record again.",
            parameters,
        )
    measured: dict[str, Any] = dict(columns(logs, clock, parameters))
    texts = _texts(logs)
    return Track(
        source=str(path),
        autopilot="ardupilot",
        vehicle=_vehicle(texts, parameters.get("FRAME_CLASS")),
        compasses=compasses,
        utc_offset_s=clock.utc_offset_s(),
        parameters=parameters,
        texts=texts,
        notes=tuple(notes),
        **measured,
    )


def read_parameters(path: Path) -> tuple[tuple[Change, ...], float | None]:
    """Read only the parameters' history of a binary log, and the Unix time of its time_s = 0.

    Raises BadRecording where the file holds no DataFlash record.
    """
    contents = read_records(path, _OF_PARAMETERS)
    if not contents.counts:
        raise BadRecording(f"{path} holds no DataFlash record.", "Give the .bin as it comes from the card.")
    clock = clock_of(contents.logs)
    return changes(parameters_seen(contents.logs, clock), clock.start_s.tolist()), clock.utc_offset_s()


_OFFSETS = (*_TIME, "I", "OfsX", "OfsY", "OfsZ")
_OF_PARAMETERS = {
    **{name: WANTED[name] for name in ("PARM", "GPS")},
    **dict.fromkeys(("MAG", "MAG2", "MAG3"), _OFFSETS),
}


def _compasses(
    logs: Sequence[Log], clock: BootClock, history: Sequence[Change]
) -> tuple[dict[int, MagSeries], list[str]]:
    """Build all compasses, and notes on them: MAG's instances count from 0, MAG2 of old firmware is the
    second."""
    out: dict[int, MagSeries] = {}
    notes: list[str] = []
    for name, base in (("MAG", 1), ("MAG2", 2), ("MAG3", 3)):
        for number, placed in take(logs, clock, name):
            instance = base + number
            reported, silences = spoken(placed.series("MagX", "MagY", "MagZ"), instance)
            if reported is None or instance in out:
                continue
            notes += silences
            steps, known = ardupilot_steps(history, instance)
            names = ardupilot_name("DEV_ID", instance)
            ids = [int(change.value) for change in history if change.name == names]
            whole = placed.whole_numbers("MagX")
            out[instance] = MagSeries(
                instance=instance,
                reported=reported,
                in_force=steps,
                correction_known=known,
                quantum_mgauss=1.0 if whole else 0.0,
                truncated=whole,
                device_id=ids[-1] if ids else None,
            )
    return dict(sorted(out.items())), notes


def _texts(logs: Sequence[Log]) -> tuple[str, ...]:
    found = [log.records["MSG"] for log in logs if "MSG" in log.records]
    return texts_said(text for one in found if "Message" in one for text in one.rows["Message"].tolist())


def _vehicle(texts: Sequence[str], frame_class: float | None) -> str:
    for text in texts:
        for firmware, vehicle in _FIRMWARES:
            if text.startswith((f"Ardu{firmware}", f"APM{firmware}", f"APM:{firmware}")):
                return "boat" if vehicle == "rover" and frame_class == _BOAT else vehicle
    return "unknown"


def _notes_about_the_file(contents: DataFlashContents) -> list[str]:
    read = f"{sum(contents.counts.values())} records"
    notes = damage(contents.skipped_bytes, contents.skipped_stretches, read)
    if len(contents.logs) > 1:
        notes.append(f"The file holds {len(contents.logs)} logs one after the other.")
    return notes


def parameters_seen(logs: Sequence[Log], clock: BootClock) -> list[Seen]:
    """List every PARM of the logs, and the offsets that MAG shows where PARM does not have them."""
    out: list[Seen] = []
    for log in logs:
        records = log.records.get("PARM")
        if records is not None and "Name" in records and "Value" in records:
            out += _parameters(records, clock)
    names = {one.name for one in out}
    for log in logs:
        for base, kind in enumerate(("MAG", "MAG2", "MAG3"), start=1):
            mag = log.records.get(kind)
            if mag is not None and all(f"Ofs{axis}" in mag for axis in "XYZ"):
                out += _mag_offsets(mag, base, clock, names)
    return out


def _parameters(records: Records, clock: BootClock) -> Iterator[Seen]:
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


def _mag_offsets(mag: Records, base: int, clock: BootClock, names: set[str]) -> Iterator[Seen]:
    """Read offsets off MAG for compasses whose COMPASS_OFS is in no PARM."""
    boot_s = boot_time_s("MAG", mag)
    if boot_s is None:
        return
    numbers = mag.rows["I"] if "I" in mag else np.zeros(len(mag), dtype=np.uint8)
    for number in np.unique(numbers).tolist():
        instance = base + int(number)
        if names & {ardupilot_name("OFS_X", instance), ardupilot_name("OFS_X", instance, "COMPASS2_OFS_X")}:
            continue
        changed = _changed(mag, numbers == number)
        some = mag.select(changed)
        time_s = clock.from_boot(some.order, boot_s[changed])
        power_up = clock.segment(some.order)
        for axis in "XYZ":
            name = ardupilot_name(f"OFS_{axis}", instance)
            offsets = some.quantity(f"Ofs{axis}")
            for moment, value, part in zip(time_s.tolist(), offsets.tolist(), power_up.tolist(), strict=True):
                yield Seen(moment, name, value, True, part)


def _changed(mag: Records, which: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Find the records, among one instance's, where the offsets are others than before."""
    rows = np.flatnonzero(which)
    fresh = np.zeros(rows.size, dtype=bool)
    fresh[:1] = True
    for axis in "XYZ":
        offsets = mag.rows[f"Ofs{axis}"][rows]
        fresh[1:] |= offsets[1:] != offsets[:-1]
    return rows[fresh][:_MOST_OFFSET_STEPS]
