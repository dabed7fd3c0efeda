"""Accelerometer and gyro that the simulation does not explain in detail: how much what they say counts."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

from mavcompass.gap.fit.hypothesis import make_term
from mavcompass.gap.fit.model import Problem
from mavcompass.gap.left.adequacy import judge
from mavcompass.gap.left.floor import first_noise, measured_noise
from mavcompass.gap.replay.noise import SensorNoise
from mavcompass.gap.replay.nominal import Replay
from mavcompass.gap.replay.nuisance import Prior
from mavcompass.gap.replay.testable import untestable_effects
from mavcompass.simulation.effects.effect import Effect, Group

# A sensor is doubted where structure shows in it that chance makes once in a thousand recordings.
_EXPLAINED_P = 1e-5
# Six degrees of tilt, three degrees a second: sensors that leave more unexplained tell nothing.
_USELESS: dict[Group, float] = {"acc": 1.0, "gyro": 0.05}
_SENSOR_WORDS: dict[Group, str] = {"mag": "compass", "acc": "accelerometer", "gyro": "gyro"}


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
        terms = [make_term(e, alone.signals) for e in effects if group in e.groups]
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


def _of_motion(effect: Effect) -> bool:
    """Tell what only motion, or a load, makes the accelerometer feel."""
    return effect.groups == ("acc",) and bool(effect.needs - {"reference"})


def doubting(
    replayed: Replay, baseline: Replay | None, effects: Collection[Effect]
) -> tuple[Replay, Replay | None]:
    """Let sensors that the simulation cannot explain, here or in the baseline, count for less in both."""
    unseen = untestable_effects(replayed, effects)
    doubtful, useless = doubtful_sensors(replayed, [e for e in effects if e.id not in unseen])
    if baseline is None:
        return _with_doubt(replayed, doubtful, useless), None
    unseen = untestable_effects(baseline, effects)
    # What a baseline's motion makes its accelerometer feel is no cause that would come again.
    steady = [e for e in effects if e.id not in unseen and not _of_motion(e)]
    more, also = doubtful_sensors(baseline, steady)
    doubtful, useless = {**doubtful, **more}, useless | also
    return _with_doubt(replayed, doubtful, useless), _with_doubt(baseline, doubtful, useless)


def _with_doubt(replayed: Replay, doubtful: Mapping[Group, SensorNoise], useless: frozenset[Group]) -> Replay:
    notes = list(replayed.notes)
    for group in replayed.groups:
        if group in doubtful or group in useless:
            how = "left out" if group in useless else "it counts for less"
            notes.append(f"The {_SENSOR_WORDS[group]} does not fit the reference in detail: {how}.")
    kept = tuple(g for g in replayed.groups if g not in useless)
    return replace(replayed, groups=kept, doubtful=doubtful, notes=tuple(notes))
