"""The attitude that a recording tells, and how far it goes: never from the compass under test."""

from mavcompass.gap.attitude.inertial import (
    accelerometer_fault,
    sensor_fault,
    without_fault,
)
from mavcompass.gap.attitude.kinematics import (
    cross_matrices,
    exponentials,
    integral,
    second_derivative,
)
from mavcompass.gap.attitude.receiver import local_position, north_east_m
from mavcompass.gap.attitude.reference import (
    SLOWEST_GYRO_S,
    UNKNOWN_YAW_RAD,
    Choice,
    Reference,
    body_rate,
    reference_attitude,
)
from mavcompass.gap.attitude.steering import steered_by

__all__ = [
    "SLOWEST_GYRO_S",
    "UNKNOWN_YAW_RAD",
    "Choice",
    "Reference",
    "accelerometer_fault",
    "body_rate",
    "cross_matrices",
    "exponentials",
    "integral",
    "local_position",
    "north_east_m",
    "reference_attitude",
    "second_derivative",
    "sensor_fault",
    "steered_by",
    "without_fault",
]
