"""Read a telemetry log (.tlog) into Tracks, one for each vehicle in it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from mavcompass.enums import MavAutopilot, MavType
from mavcompass.errors import BadRecording, NoMagnetometer
from mavcompass.logs.common import damage
from mavcompass.logs.formats.tlog.clock import in_turns
from mavcompass.logs.formats.tlog.messages import Messages, Sender, TlogContents, read_messages
from mavcompass.logs.formats.tlog.vehicle import track_of
from mavcompass.track import Track
from mavcompass.two_clocks import shared_id

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
    "SYS_STATUS": ("current_battery",),
    "BATTERY_STATUS": ("id", "current_battery"),
    "VFR_HUD": ("throttle",),
    "SERVO_OUTPUT_RAW": ("port", *(f"servo{n}_raw" for n in range(1, 9))),
    "SIMSTATE": ("roll", "pitch", "yaw"),
    "PARAM_VALUE": ("param_id", "param_value", "param_type", "param_index"),
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
