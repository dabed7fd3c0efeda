"""The attitude that a recording tells, and how far it goes: never from the compass under test."""

from mavcompass.gap.attitude.inertial import inertial_faults, without_faults
from mavcompass.gap.attitude.receiver import local_position, north_east_m
from mavcompass.gap.attitude.reference import (
    UNKNOWN_YAW_RAD,
    Choice,
    Reference,
    body_rate,
    reference_attitude,
)

__all__ = [
    "UNKNOWN_YAW_RAD",
    "Choice",
    "Reference",
    "body_rate",
    "inertial_faults",
    "local_position",
    "north_east_m",
    "reference_attitude",
    "without_faults",
]
