"""Which traces in the numbers are effects: repeats and steps that no healthy vehicle shows."""

from __future__ import annotations

import math

import numpy as np

from mavcompass.gap.replay import Replay

# MAVLink's messages and ArduPilot's parameters count whole milligauss.
_USUAL_STEP_MGAUSS = 1.0 + 1e-6
_REPEATS_WORTH_NAMING = 0.003
# A sensor's steps are told from those of the messages only where they are far coarser: in units of the noise
# that rounding to the messages' makes.
_MUCH_COARSER = 14.0
# Autopilots read their compass ten times a second and repeat it meanwhile; a rest may look like a repeat.
# While the field changes by this, or the vehicle turns so far, a live sensor changes too.
_MOVED_MGAUSS, _TURNED_RAD = 5.0, math.radians(2.0)
_TELEMETRY_HOLDS_S, _FAR_LONGER = 0.3, 1.5
# Messages as often as readings fall beside them now and then: one reading in two of them.
_SEEN_TWICE_S = 0.2


def names_stale(replay: Replay, baseline: Replay | None) -> bool:
    """Tell whether the repeats are an effect: more than by chance, than the baseline's, than telemetry's."""
    if replay.telemetry:
        return _frozen_share(replay, baseline) > _REPEATS_WORTH_NAMING
    found, nominal = replay.trace, baseline.trace if baseline is not None else None
    expected = nominal.stale_share if nominal is not None else 0.0
    coarse = found.step_mgauss > 0.0 or replay.resolution_mgauss > 0.0
    if coarse and (baseline is None or _steps_of(replay) != _steps_of(baseline)):
        # Coarse numbers repeat by chance, and no baseline tells how often.
        return False
    count = found.stale.size
    noise = math.sqrt(max(expected * (1.0 - expected), 1.0 / count) / count)
    return found.stale_share > max(_REPEATS_WORTH_NAMING, expected + 5.0 * noise)


def stale_share(replay: Replay, baseline: Replay | None) -> float:
    """Return the share of readings that only repeat the one before, beyond what telemetry does by nature."""
    return _frozen_share(replay, baseline) if replay.telemetry else replay.trace.stale_share


def _frozen_share(replay: Replay, baseline: Replay | None) -> float:
    """Return the share of time in which readings stayed far longer than they do in a healthy vehicle.

    Only where the gyro turned meanwhile, and the next reading jumps: a compass without noise that stands
    still repeats itself for as long, and coarse numbers for as long as the field stays within their step.
    """
    trace = replay.trace
    usual = _TELEMETRY_HOLDS_S
    if baseline is not None and baseline.telemetry and baseline.trace.held_s.size:
        usual = max(
            float(baseline.trace.held_s.max()), _SEEN_TWICE_S, 0.5 * float(np.median(np.diff(replay.time_s)))
        )
    # Coarse numbers change only with the field, and how the last one would have changed nobody knows.
    steps = 2.0 * trace.step_mgauss
    missed = trace.jump_mgauss > max(_MOVED_MGAUSS, steps)
    if steps > _MOVED_MGAUSS:
        missed &= np.isfinite(trace.jump_mgauss)
    held = trace.held_s[missed & (trace.turned_rad > _TURNED_RAD) & (trace.held_s > _FAR_LONGER * usual)]
    span = float((trace.fresh_s + trace.held_s).max(initial=replay.time_s[-1]) - replay.time_s[0])
    return float(held.sum()) / max(span, 1e-9)


def _steps_of(replay: Replay) -> tuple[float, float]:
    return replay.trace.step_mgauss, replay.resolution_mgauss


def names_step(replay: Replay, baseline: Replay | None, noise_mgauss: float) -> bool:
    """Tell whether the step of the numbers is an effect: coarse beside the noise, and not nominal."""
    found, nominal = replay.trace, baseline.trace if baseline is not None else None
    if found.step_mgauss <= _MUCH_COARSER * replay.resolution_mgauss:
        return False
    if found.step_mgauss <= _USUAL_STEP_MGAUSS:
        return False
    if nominal is not None and nominal.step_mgauss > 0.9 * found.step_mgauss:
        return False
    return found.step_mgauss > 0.5 * noise_mgauss
