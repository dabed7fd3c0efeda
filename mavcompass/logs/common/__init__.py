"""What readers of several formats share: clock, order in time, corrections in force, large files."""

from __future__ import annotations

from mavcompass.logs.common.boot_clock import BootClock, build_clock, impossible_times
from mavcompass.logs.common.chunks import (
    CHUNK_BYTES,
    MOST_LINE,
    ByteArray,
    Chunk,
    GrowingArray,
    IntArray,
    not_overlapping,
    read_chunks,
    windows,
)
from mavcompass.logs.common.motors import motor_outputs
from mavcompass.logs.common.notes import damage, restarts, said_nothing, unknown_correction
from mavcompass.logs.common.ordering import finite_series, in_order, spoken
from mavcompass.logs.common.parameter_steps import Change, Seen, ardupilot_steps, changes, px4_steps

__all__ = [
    "CHUNK_BYTES",
    "MOST_LINE",
    "BootClock",
    "ByteArray",
    "Change",
    "Chunk",
    "GrowingArray",
    "IntArray",
    "Seen",
    "ardupilot_steps",
    "build_clock",
    "changes",
    "damage",
    "finite_series",
    "impossible_times",
    "in_order",
    "motor_outputs",
    "not_overlapping",
    "px4_steps",
    "read_chunks",
    "restarts",
    "said_nothing",
    "spoken",
    "unknown_correction",
    "windows",
]
