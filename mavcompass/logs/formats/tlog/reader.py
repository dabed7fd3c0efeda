"""Read a telemetry log (.tlog) into Tracks, one for each vehicle in it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mavcompass.compass_parameters import px4_name
from mavcompass.enums import MavAutopilot, MavType
from mavcompass.errors import BadRecording, NoMagnetometer
from mavcompass.kinds import AUTOPILOTS, VEHICLES
from mavcompass.logs.common.boot_clock import BootClock
from mavcompass.logs.common.chunks import damage
from mavcompass.logs.common.parameter_steps import Change, Seen, changes, unknown_correction
from mavcompass.logs.common.samples import texts_said
from mavcompass.logs.formats.tlog.clock import Placer, in_turns, keep_one_vehicle
from mavcompass.logs.formats.tlog.columns import HIGHRES, body_columns, columns, compass_of, spokesmen
from mavcompass.logs.formats.tlog.messages import Messages, Sender, TlogContents, read_messages
from mavcompass.messages import telemetry
from mavcompass.messages.bits import number_told
from mavcompass.track import MagSeries, Series, Track
from mavcompass.two_clocks import shared_id
from mavcompass.units import MPS2_PER_MILLI_G, RADPS_PER_MILLIRADPS

_MILLI = 0.001
# PARAM_VALUE without a place in the list: the answer to a write, not to a download.
_NO_INDEX = 65535
_SHARED = (
    "Two autopilots share a system id and were recorded at the same time: only the one that said most is "
    "read. Give each its own (SYSID_THISMAV, MAV_SYS_ID)."
)


def track_of(messages: dict[str, Messages], source: str, notes: tuple[str, ...]) -> Track:
    """Build the track of one vehicle; `messages` is emptied on the way, to spare memory."""
    clock, shared = keep_one_vehicle(messages)
    if shared:
        notes = (*notes, _SHARED)
    autopilot, vehicle = _identity(messages.pop("HEARTBEAT", None))
    heard = messages.pop("STATUSTEXT", None)
    utc_offset_s = _utc_offset(messages.get("SYSTEM_TIME"), clock)
    history = changes(parameters_seen(messages, clock, autopilot), clock.start_s.tolist())
    parameters = {change.name: change.value for change in history}
    placer = Placer(messages, clock)
    compasses, body, notes_about_compasses = _compasses(placer, autopilot, history, parameters)
    # The first compass's own thermometer is nearer to it than the barometer's.
    measured: dict[str, Any] = {**columns(placer, parameters), **body}
    cut = body and compasses and next(iter(compasses.values())).quantum_mgauss > 0.0
    return Track(
        source=source,
        autopilot=autopilot,
        vehicle=vehicle,
        compasses=compasses,
        acc_truncation_mps2=MPS2_PER_MILLI_G if cut else 0.0,
        gyro_truncation_radps=RADPS_PER_MILLIRADPS if cut else 0.0,
        utc_offset_s=utc_offset_s,
        parameters=parameters,
        texts=() if heard is None else texts_said(heard.rows.text.tolist()),
        notes=(*notes, *_notes_about_time(clock, placer), *notes_about_compasses),
        **measured,
    )


def _compasses(
    placer: Placer, autopilot: str, history: Sequence[Change], parameters: Mapping[str, float]
) -> tuple[dict[int, MagSeries], dict[str, Series], list[str]]:
    """Build all compasses, and what the first one's message tells of the body; and notes."""
    chosen = spokesmen(placer.count, autopilot, px4_name("ROT", 1) in parameters)
    for name in {*telemetry.MAG_MESSAGES, HIGHRES} - set(chosen.values()):
        placer.drop(name)
    compasses: dict[int, MagSeries] = {}
    body: dict[str, Series] = {}
    notes: list[str] = []
    for instance, name in chosen.items():
        samples = placer.take(name)
        if samples is None:
            continue
        body = body or body_columns(samples)
        compass, more = compass_of(instance, samples, autopilot, history, parameters)
        notes += more
        if compass is None:
            continue
        compasses[instance] = compass
        if not compass.correction_known:
            unknown = f"The autopilot is not known: compass {instance} is taken as it is, as if uncorrected."
            notes.append(unknown if autopilot == "unknown" else unknown_correction(instance))
    return compasses, body, notes


def _identity(heartbeats: Messages | None) -> tuple[str, str]:
    if heartbeats is None:
        return "unknown", "unknown"
    (autopilot, kind), _ = Counter(
        zip(heartbeats.rows.autopilot.tolist(), heartbeats.rows.type.tolist(), strict=True)
    ).most_common(1)[0]
    return AUTOPILOTS.get(autopilot, "unknown"), VEHICLES.get(kind, "unknown")


def _notes_about_time(clock: BootClock, placer: Placer) -> list[str]:
    notes = clock.restarts()
    if placer.misplaced:
        carry = "1 message carries" if placer.misplaced == 1 else f"{placer.misplaced} messages carry"
        notes.append(f"{carry} an impossible time: placed by arrival.")
    if placer.repeats:
        notes.append(f"Left out {placer.repeats} messages that were recorded twice.")
    if clock.log_jumps:
        notes.append(f"The logging clock jumped {clock.log_jumps} times; the vehicle's own was followed.")
    return notes


def _utc_offset(system_time: Messages | None, clock: BootClock) -> float | None:
    """Return the Unix time of time_s = 0, by the vehicle's clock (GPS) or else by the log's."""
    if system_time is not None:
        unix_s = system_time.rows.time_unix_usec * 1.0e-6
        set_ = (unix_s > 1.0e9) & (system_time.rows.time_boot_ms > 0)
        if bool(set_.any()):
            time_s = clock.from_boot(system_time.order[set_], system_time.rows.time_boot_ms[set_] * _MILLI)
            return float(np.median(unix_s[set_] - time_s))
    return clock.utc_offset_s()


def parameters_seen(messages: dict[str, Messages], clock: BootClock, autopilot: str) -> list[Seen]:
    """List every PARAM_VALUE; SENSOR_OFFSETS of old ArduPilot stands in where the offsets are not among them.

    PX4 sends integers as the bytes of a float, ArduPilot as a float of the same value.
    """
    out = _parameters(messages.pop("PARAM_VALUE", None), clock, as_bytes=autopilot == "px4")
    offsets = messages.pop("SENSOR_OFFSETS", None)
    if offsets is not None and not any(one.name == "COMPASS_OFS_X" for one in out):
        out = _sensor_offsets(offsets, clock) + out
    return out


def _parameters(found: Messages | None, clock: BootClock, *, as_bytes: bool) -> list[Seen]:
    if found is None:
        return []
    time_s = clock.from_log(found.order, found.log_time_s)
    power_up = clock.segment(found.order)
    rows = found.rows
    columns = zip(
        time_s.tolist(),
        rows.param_id.tolist(),
        rows.param_value.tolist(),
        rows.param_type.tolist(),
        rows.param_index.tolist(),
        power_up.tolist(),
        strict=True,
    )
    return [
        Seen(
            time_s=moment,
            name=name.decode("ascii", "replace"),
            value=number_told(value, kind) if as_bytes else value,
            announced=index == _NO_INDEX,
            power_up=number,
        )
        for moment, name, value, kind, index, number in columns
    ]


def _sensor_offsets(found: Messages, clock: BootClock) -> list[Seen]:
    time_s = clock.from_log(found.order, found.log_time_s)
    power_up = clock.segment(found.order)
    return [
        Seen(moment, f"COMPASS_OFS_{axis}", float(value), announced=True, power_up=number)
        for moment, number, row in zip(time_s.tolist(), power_up.tolist(), found.rows.tolist(), strict=True)
        for axis, value in zip("XYZ", row, strict=True)
    ]


_IMU_FIELDS = ("xacc", "yacc", "zacc", "xgyro", "ygyro", "zgyro", "xmag", "ymag", "zmag", "temperature")
WANTED: dict[str, tuple[str, ...]] = {
    "HEARTBEAT": ("type", "autopilot"),
    "RAW_IMU": ("time_usec", *_IMU_FIELDS),
    "SCALED_IMU": ("time_boot_ms", *_IMU_FIELDS),
    "SCALED_IMU2": ("time_boot_ms", *_IMU_FIELDS),
    "SCALED_IMU3": ("time_boot_ms", *_IMU_FIELDS),
    "HIGHRES_IMU": ("time_usec", *_IMU_FIELDS),
    "ATTITUDE": ("time_boot_ms", "roll", "pitch", "yaw"),
    "GLOBAL_POSITION_INT": ("time_boot_ms", "lat", "lon", "alt", "vx", "vy", "vz"),
    "LOCAL_POSITION_NED": ("time_boot_ms", "x", "y", "z"),
    "GPS_RAW_INT": ("fix_type", "lat", "lon", "alt", "vel", "cog", "yaw"),
    "SYSTEM_TIME": ("time_unix_usec", "time_boot_ms"),
    "SCALED_PRESSURE": ("time_boot_ms", "temperature"),
    "SYS_STATUS": ("voltage_battery", "current_battery"),
    "BATTERY_STATUS": ("id", "current_battery"),
    "VFR_HUD": ("throttle",),
    "SERVO_OUTPUT_RAW": ("port", *(f"servo{n}_raw" for n in range(1, 9))),
    "SIMSTATE": ("roll", "pitch", "yaw"),
    "PARAM_VALUE": ("param_id", "param_value", "param_type", "param_index"),
    "STATUSTEXT": ("text",),
    "SENSOR_OFFSETS": ("mag_ofs_x", "mag_ofs_y", "mag_ofs_z"),
}
MAGNETOMETER_MESSAGES = ("RAW_IMU", "SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3", "HIGHRES_IMU")

_NOT_VEHICLES = {
    MavType.GCS,
    MavType.ONBOARD_CONTROLLER,
    MavType.GIMBAL,
    MavType.ADSB,
    MavType.CAMERA,
    MavType.ANTENNA_TRACKER,
}


def read_tlog(path: Path) -> dict[int, Track]:
    """Read the tracks of all vehicles that reported a magnetometer, by system id.

    Raises BadRecording where there is none, or the file is no telemetry log.
    """
    contents = read_messages(path, WANTED)
    if not contents.frames:
        raise BadRecording(
            f"{path} holds no MAVLink message with a good checksum: it is no telemetry log, or all damaged.",
            "Give a .tlog as a ground station or MAVProxy writes it.",
        )
    vehicles = _vehicles(contents.senders)
    notes = _notes_about_the_file(contents)
    read: dict[int, Track] = {}
    shared: list[int] = []
    for sender in vehicles:
        _adopt_parameters(contents.senders, sender)
        # Taken out of the contents, so that each message is freed when it has become a column.
        messages = contents.senders.pop(sender)
        if in_turns(messages):
            shared.append(sender[0])
        else:
            read[sender[0]] = track_of(messages, str(path), notes)
    tracks = {system: track for system, track in read.items() if track.compasses}
    if shared and not tracks:
        raise BadRecording(*shared_id(shared[0]))
    if not tracks:
        told = max(read.values(), key=lambda track: len(track.parameters), default=Track())
        remedy = _REMEDY.format(_STREAMS.get(told.autopilot, "SET_MESSAGE_INTERVAL"))
        raise NoMagnetometer(_without_magnetometer(path, contents, vehicles), remedy, told.parameters)
    return tracks


_REMEDY = "Ask the vehicle for its IMU's messages ({}) and record again, or give the autopilot's own log."
_STREAMS = {
    "ardupilot": "RAW_IMU: SET_MESSAGE_INTERVAL, or SR0_RAW_SENS at 10 Hz or more",
    "px4": "SCALED_IMU: SET_MESSAGE_INTERVAL, or `mavlink stream` on its console",
}


def _without_magnetometer(path: Path, contents: TlogContents, vehicles: list[Sender]) -> str:
    if not vehicles:
        return (
            f"{path} holds {contents.frames} MAVLink messages, but none from a vehicle with a magnetometer."
        )
    systems = ", ".join(str(system) for system, _ in vehicles)
    return (
        f"{path} holds no magnetometer: system {systems} sent no RAW_IMU, SCALED_IMU or HIGHRES_IMU "
        "with a magnetic field."
    )


def _vehicles(senders: Mapping[Sender, Mapping[str, Messages]]) -> list[Sender]:
    """Find the autopilots: one component for each system, by what its heartbeat says it is.

    Where no heartbeat at all says so, a component that reported a magnetic field is taken for one.
    """
    candidates = [sender for sender, messages in senders.items() if _is_autopilot(messages)]
    if not candidates:
        candidates = [
            sender
            for sender, messages in senders.items()
            if "HEARTBEAT" not in messages and any(name in messages for name in MAGNETOMETER_MESSAGES)
        ]
    best: dict[int, Sender] = {}
    for sender in candidates:
        rival = best.get(sender[0])
        if rival is None or _weight(senders[sender]) > _weight(senders[rival]):
            best[sender[0]] = sender
    return list(best.values())


def _adopt_parameters(senders: Mapping[Sender, dict[str, Messages]], vehicle: Sender) -> None:
    """Take what its system's addresses without a heartbeat tell for the autopilot's parameters, too.

    No component is without one: MAVProxy logs so, as 190, what it fetched from the vehicle as a file.
    """
    name, told = "PARAM_VALUE", []
    for sender, said in senders.items():
        if name in said and (sender == vehicle or (sender[0] == vehicle[0] and "HEARTBEAT" not in said)):
            told.append(said[name])
    if told:
        rows, order, stamps = (
            np.concatenate([getattr(one, column) for one in told]) for column in Messages.__slots__
        )
        senders[vehicle][name] = Messages(rows.view(np.recarray), order, stamps).select(np.argsort(order))


def _weight(messages: Mapping[str, Messages]) -> tuple[int, int]:
    imu = sum(len(messages[name]) for name in MAGNETOMETER_MESSAGES if name in messages)
    return imu, sum(len(one) for one in messages.values())


def _is_autopilot(messages: Mapping[str, Messages]) -> bool:
    heartbeats = messages.get("HEARTBEAT")
    if heartbeats is None:
        return False
    flies = heartbeats.rows.autopilot != MavAutopilot.INVALID
    flies &= ~np.isin(heartbeats.rows.type, list(_NOT_VEHICLES))
    return bool(2 * np.count_nonzero(flies) > flies.size)


def _notes_about_the_file(contents: TlogContents) -> tuple[str, ...]:
    notes = damage(
        contents.skipped_bytes, contents.skipped_stretches, f"{contents.frames} messages", contents.cut_off
    )
    if contents.unknown_frames:
        notes.append(
            f"Passed over {contents.unknown_frames} messages of kinds that the dialect does not have."
        )
    return tuple(notes)
