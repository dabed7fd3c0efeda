"""Assemble one vehicle's Track from its MAVLink messages."""

from __future__ import annotations

from collections import Counter

import numpy as np

from mavcompass import telemetry
from mavcompass.compass_parameters import px4_name
from mavcompass.logs.boot_clock import BootClock
from mavcompass.logs.mavlink_kinds import AUTOPILOTS, VEHICLES
from mavcompass.logs.parameter_steps import changes
from mavcompass.logs.tlog_columns import body_columns, columns
from mavcompass.logs.tlog_compass import compass_of, spokesmen
from mavcompass.logs.tlog_messages import Messages
from mavcompass.logs.tlog_parameters import parameters_seen
from mavcompass.logs.tlog_time import clock_of, place_messages
from mavcompass.track import MagSeries, Track

_MILLI = 0.001


def track_of(messages: dict[str, Messages], source: str, notes: tuple[str, ...]) -> Track:
    """Build the track of one vehicle; `messages` is emptied on the way, to spare memory."""
    autopilot, vehicle = _identity(messages.pop("HEARTBEAT", None))
    clock = clock_of(messages)
    utc_offset_s = _utc_offset(messages.get("SYSTEM_TIME"), clock)
    all_notes = [*notes, *_notes_about_time(clock)]
    history = changes(parameters_seen(messages, clock, autopilot), clock.start_s.tolist())
    parameters = {change.name: change.value for change in history}
    samples, repeats = place_messages(messages, clock)
    if repeats:
        all_notes.append(f"Left out {repeats} messages that were recorded twice.")

    compasses: dict[int, MagSeries] = {}
    rotation_known = px4_name("ROT", 1) in parameters
    chosen = spokesmen(samples, autopilot, rotation_known)
    for instance, spokesman in chosen.items():
        compass, more = compass_of(instance, spokesman, autopilot, history, parameters)
        if not bool(compass.reported.values.any()):
            all_notes.append(f"{spokesman.name} carries no magnetic field: there is no compass {instance}.")
            continue
        compasses[instance] = compass
        all_notes += more
        if not compass.correction_known:
            all_notes.append(_unknown_correction(instance, autopilot))
    body = chosen.get(1) or next(iter(chosen.values()), None)
    for name in telemetry.MAG_MESSAGES:
        if body is None or name != body.name:
            samples.pop(name, None)
    return Track(
        source=source,
        autopilot=autopilot,
        vehicle=vehicle,
        compasses=compasses,
        utc_offset_s=utc_offset_s,
        parameters=parameters,
        notes=tuple(all_notes),
        **body_columns(body),
        **columns(samples, parameters),
    )


def _identity(heartbeats: Messages | None) -> tuple[str, str]:
    if heartbeats is None:
        return "unknown", "unknown"
    (autopilot, kind), _ = Counter(
        zip(heartbeats.rows.autopilot.tolist(), heartbeats.rows.type.tolist(), strict=True)
    ).most_common(1)[0]
    return AUTOPILOTS.get(autopilot, "unknown"), VEHICLES.get(kind, "unknown")


def _unknown_correction(instance: int, autopilot: str) -> str:
    if autopilot == "unknown":
        return f"The autopilot is not known: compass {instance} is taken as it is, as if uncorrected."
    return (
        f"The parameters of compass {instance} are not in the recording: its readings are taken as they are, "
        "with whatever correction was inside them."
    )


def _notes_about_time(clock: BootClock) -> list[str]:
    notes = []
    restarts = clock.shift_s.size - 1
    if restarts:
        at = ", ".join(f"{start:.1f}" for start in clock.start_s[1:6])
        notes.append(
            f"The autopilot was started {restarts + 1} times; time_s goes on across the restarts (at {at} s)."
        )
    if clock.glitches.size:
        notes.append(f"Left out {clock.glitches.size} messages with an impossible time.")
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
