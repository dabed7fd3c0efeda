"""The floor that is stated without a baseline: scatter, and the doubt in the attitude and in the times.

The scatter is that between neighbouring readings and the numbers' resolution; the verdict is more careful.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from mavcompass.gap.left.floor import (
    Floor,
    field_channels,
    first_noise,
    nominal_rate,
    prior_of,
    rms,
)
from mavcompass.gap.replay import (
    STATED,
    USUAL_SCATTER_MGAUSS,
    WORST_SCATTER_MGAUSS,
    Replay,
    SensorNoise,
    wandering,
)

_REFERENCE_DOUBT_RAD = {
    "columns": math.radians(0.2),
    "fused": math.radians(0.4),
    "gps-yaw": math.radians(0.5),
    "gyro": math.radians(0.4),
    "attitude": math.radians(1.0),
}
_DOUBT_LASTS_S = 5.0
# How much of the doubt shows along the field, where only the calibration and what nobody models is in doubt,
# and across it.
_ACROSS = np.array([0.6, 1.0, 1.0])
_TIME_DOUBT_S = {"telemetry": 0.03, "direct": 0.01}


def from_recording(replay: Replay) -> Floor:
    """State a floor without a baseline: scatter, the reference's slow doubt, and the doubt in the times.

    The doubt in the attitude wanders, as a first-order process of some seconds; the doubt in the times
    grows with the field's rate of change. Scatter that no data sheet allows is not the floor's.
    """
    noise = first_noise(replay)
    scatter = noise["mag"].sigma
    world = replay.signals.stimulus.field_ned_mgauss[0]
    total, level = float(np.linalg.norm(world)), max(float(np.hypot(world[0], world[1])), 1.0)
    doubt = max(_REFERENCE_DOUBT_RAD[replay.reference.kind], replay.reference.tilt_sigma_rad)
    white_rms = math.sqrt(float(np.mean(scatter**2)))
    usual = white_rms if white_rms < WORST_SCATTER_MGAUSS else USUAL_SCATTER_MGAUSS
    step = float(np.median(np.diff(replay.time_s)))
    rho = math.exp(-step / _DOUBT_LASTS_S)
    channels = field_channels(replay)
    # A small random rotation moves the field by doubt |B| in the two directions across it.
    slow = np.full(3, doubt * total * math.sqrt(2.0 / 3.0)) if channels is None else doubt * total * _ACROSS
    each = [
        wandering(np.full(3, white_rms) if channels is not None else scatter, float(v), rho) for v in slow
    ]
    sigma = np.array([one[0][c] for c, one in enumerate(each)])
    late = _TIME_DOUBT_S["telemetry" if replay.telemetry else "direct"]
    whole = np.hypot(white_rms, slow)
    mag = SensorNoise(
        np.full((1, 3), rho),
        sigma,
        whole,
        np.inf,
        moving=np.array([one[1] for one in each]),
        channels=channels,
    )
    change = nominal_rate(replay, mag)
    mag = replace(mag, row_scale=np.sqrt(1.0 + (late * change / sigma) ** 2))
    timing = late * math.sqrt(float(np.mean(change[replay.valid] ** 2)))
    trust = STATED if replay.iron.calibrated else None
    # What a calibration usually leaves is no gap: it belongs to the floor.
    doubted = replay.iron.sigma(STATED)
    cured = 0.0 if trust is None else math.hypot(rms(doubted[:3]), rms(doubted[3:]) * total)
    return Floor(
        {**noise, "mag": mag},
        math.hypot(usual, float(np.sqrt(np.mean(slow**2))), timing, cured),
        math.degrees(math.hypot(usual, doubt * total, timing, cured) / level),
        np.zeros((0, 3)),
        False,
        prior_of(replay, trust),
        trust=trust,
    )
