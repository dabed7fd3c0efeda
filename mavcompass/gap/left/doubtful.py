"""Accelerometer and gyro that the simulation does not explain in detail: how much what they say counts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from mavcompass.gap.fit import Problem, make_term
from mavcompass.gap.left.adequacy import judge
from mavcompass.gap.left.floor import first_noise, measured_noise
from mavcompass.gap.replay import Prior, Replay, SensorNoise
from mavcompass.simulation.effects.effect import Effect, Group

# A sensor is doubted where structure shows in it that chance makes once in a thousand recordings.
_EXPLAINED_P = 1e-5
# Six degrees of tilt, three degrees a second: sensors that leave more unexplained tell nothing.
_USELESS: dict[Group, float] = {"acc": 1.0, "gyro": 0.05}
# fmt: off
_INERTIAL: dict[Group, tuple[str, ...]] = {
    "acc": (
        "accel_bias", "accel_scale", "linear_acceleration", "vibration_rectification", "platform_tilt",
        "attitude_reference_error", "yaw_step_error",
    ),
    "gyro": ("gyro_bias", "gyro_scale", "yaw_step_error", "attitude_reference_error"),
}
# fmt: on


def doubtful_sensors(
    witness: Replay, effects: Sequence[Effect]
) -> tuple[dict[Group, SensorNoise], frozenset[Group]]:
    """Tell which sensors of a recording the simulation does not explain, with all that it knows of them.

    A real accelerometer or gyro feels unknown motion, vibration, imperfect timing against the reference. What
    it says about a cause then counts by the noise that would make all this look like chance: the noise of
    its residual, raised until the worst of the structure in it is no more than that. Sensors that then would
    say nothing are the second set. `effects` are those that the recording can test.
    """
    out: dict[Group, SensorNoise] = {}
    useless: set[Group] = set()
    for group in witness.groups:
        if group == "mag":
            continue
        alone = replace(witness, groups=(group,))
        terms = [make_term(e, alone.signals) for e in effects if e.id in _INERTIAL[group]]
        problem = Problem(alone, first_noise(alone), alone.valid, Prior.of(()))
        fit = problem.fit(terms, [t.effect.neutral() for t in terms], ())
        noise = measured_noise(problem, fit)
        structure = judge(Problem(alone, noise, alone.valid, Prior.of(())), fit, compare_scatter=False)
        if min((t.p for t in structure.tests), default=1.0) > _EXPLAINED_P:
            continue
        worse = math.sqrt(max(1.0, *(t.excess for t in structure.tests)))
        own = noise[group]
        if float(own.rms.mean()) * worse > _USELESS[group]:
            useless.add(group)
        else:
            out[group] = replace(own, sigma=own.sigma * worse, rms=own.rms * worse)
    return out, frozenset(useless)
