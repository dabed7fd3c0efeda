"""The parameters that a telemetry log shows, with their times."""

from __future__ import annotations

from mavcompass.logs.common import BootClock, Seen
from mavcompass.logs.formats.tlog.messages import Messages
from mavcompass.messages.bits import number_told

# PARAM_VALUE without a place in the list: the answer to a write, not to a download.
_NO_INDEX = 65535


def parameters_seen(messages: dict[str, Messages], clock: BootClock, autopilot: str) -> list[Seen]:
    """List every PARAM_VALUE; SENSOR_OFFSETS of old ArduPilot stands in where the offsets are not among them.

    PX4 sends integers as the bytes of a float, ArduPilot as a float of the same value.
    """
    out = _values(messages.pop("PARAM_VALUE", None), clock, as_bytes=autopilot == "px4")
    offsets = messages.pop("SENSOR_OFFSETS", None)
    if offsets is not None and not any(one.name == "COMPASS_OFS_X" for one in out):
        out = _sensor_offsets(offsets, clock) + out
    return out


def _values(found: Messages | None, clock: BootClock, *, as_bytes: bool) -> list[Seen]:
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
