"""Assemble one vehicle's Track from its MAVLink messages."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mavcompass.compass_parameters import px4_name
from mavcompass.kinds import AUTOPILOTS, VEHICLES
from mavcompass.logs.common import BootClock, Change, changes, restarts, unknown_correction
from mavcompass.logs.formats.tlog.clock import Placer, keep_one_vehicle
from mavcompass.logs.formats.tlog.columns import body_columns, columns
from mavcompass.logs.formats.tlog.compasses import HIGHRES, compass_of, spokesmen
from mavcompass.logs.formats.tlog.messages import Messages
from mavcompass.logs.formats.tlog.parameters import parameters_seen
from mavcompass.messages import telemetry
from mavcompass.track import MagSeries, Series, Track
from mavcompass.units import MPS2_PER_MILLI_G, RADPS_PER_MILLIRADPS

_MILLI = 0.001
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
    notes = restarts(clock)
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
