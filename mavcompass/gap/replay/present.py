"""What a recording contains of the needs of effects: turning, tilt, loads that vary, a way."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mavcompass.gap.attitude import Reference
from mavcompass.simulation.physics.signals import Stimulus

_TURNING_RAD = math.radians(25.0)
_TILT_RAD = math.radians(4.0)
_LEAST_CLIMB_M = 4.0
# What a load must at least vary by to be told from everything else that happens meanwhile.
_LEAST_RANGE = {"current": 0.5, "throttle": 0.05, "temperature": 3.0}


def present_in(
    stimulus: Stimulus, reference: Reference, goes_about: bool, valid: NDArray[np.bool_]
) -> frozenset[str]:
    """List what a recording contains of the needs of effects, its `valid` rows (N,) of motion.

    `goes_about` tells whether its path is longer than the errors of its places.
    """
    present = set()
    for name, values in (
        ("current", stimulus.current_a),
        ("throttle", stimulus.throttle),
        ("temperature", stimulus.temperature_degc),
    ):
        if np.isfinite(values).any() and float(np.ptp(values[np.isfinite(values)])) > _LEAST_RANGE[name]:
            present.add(name)
    if stimulus.motors.size and float(np.ptp(stimulus.motors, axis=0).max()) > _LEAST_RANGE["throttle"]:
        present.add("motors")
    if goes_about:
        present.add("position")
    if float(np.ptp(stimulus.position_ned_m[:, 2])) > _LEAST_CLIMB_M:
        present.add("height")
    rotation = stimulus.rotation[valid]
    if len(rotation):
        ahead = rotation[:, :2, 0] / np.maximum(np.linalg.norm(rotation[:, :2, 0], axis=1), 1e-9)[:, None]
        if float(np.hypot(*np.mean(ahead, axis=0))) < math.cos(_TURNING_RAD):
            present.add("turning")
        spread = np.sqrt(np.var(rotation[:, 2, 0]) + np.var(rotation[:, 2, 1]))
        if spread > math.sin(_TILT_RAD):
            present.add("tilt")
    if reference.kind == "columns":
        present.add("reference")
    return frozenset(present)
