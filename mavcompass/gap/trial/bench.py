"""Cases of the first generator, the bench: drawn from the catalogue, with an independent attitude."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import cast

import numpy as np

from mavcompass.frames import FloatArray
from mavcompass.gap.fit.model import Problem
from mavcompass.gap.replay.noise import group_values
from mavcompass.gap.replay.nominal import replay
from mavcompass.gap.replay.nuisance import Prior
from mavcompass.gap.trial.cases import (
    CASE_NOISE,
    MOTIONS,
    SHARES,
    Label,
    Motion,
    Recipe,
    Tier,
    affected,
    noisy,
    stimulus_of,
    to_track,
)
from mavcompass.simulation.effects import Distortion, Effect, Setting, catalogue, parse, spell
from mavcompass.simulation.effects.effect import GROUPS, MOMENTS, Parameter, Stage
from mavcompass.simulation.physics.signals import Stimulus, ideal
from mavcompass.track import Track

_SIZES = (6.0, 150.0)
_CLEAR = 0.9
_FOUND_BY_TRACE = frozenset({"quantisation", "stale_samples", "noise_excess", "timestamp_jitter"})
_NEVER_NAMED = frozenset({"bias_random_walk"})


def usable_effects(stimulus: Stimulus) -> list[Effect]:
    """List the effects that a motion can show at all."""
    varied = {name for name, values in stimulus.loads.items() if float(np.ptp(values)) > 3.0e-1}
    if float(np.ptp(stimulus.motors, axis=0).max()) > 0.05:
        varied.add("motors")
    if float(np.ptp(stimulus.position_ned_m, axis=0).max()) > 0.2:
        varied.add("position")
    down = stimulus.rotation[:, 2, :2]
    if math.sqrt(float(down.var(axis=0).sum())) > math.sin(math.radians(4.0)):
        varied.add("tilt")
    varied |= {"turning", "reference"}
    return [
        e
        for e in catalogue().values()
        if e.id not in _NEVER_NAMED and all(any(o in varied for o in n.split("|")) for n in e.needs)
    ]


def draw_setting(effect: Effect, stimulus: Stimulus, rng: np.random.Generator) -> Setting:
    """Draw parameters of typical size and random direction."""
    theta = effect.default.copy()
    for i, p in enumerate(effect.parameters):
        if _is_amplitude(p):
            theta[i] = p.scale * rng.normal() * 2.0
        elif p.low >= 0.0 and not p.integer:
            theta[i] = p.default * math.exp(rng.uniform(-0.7, 0.7))
    span = float(stimulus.time_s[-1])
    if effect.id == "hard_iron_step":
        theta[3] = rng.uniform(0.15, 0.7) * span
        theta[4] = rng.uniform(theta[3] / span + 0.1, 0.95) * span
        if rng.random() < 0.5:
            theta[4] = effect.parameters[4].high
    elif effect.id == "orientation":
        theta[0] = float(rng.choice([2, 4, 6, 8, 10, 16, 18, 24, 25]))
    elif effect.id == "ac_interference":
        theta[6] = rng.uniform(0.5, 9.0)
    elif effect.id == "spatial_dipole":
        theta[:3] = rng.normal(0.0, 2.5, 3)
        theta[3:6] = rng.normal(0.0, 60.0, 3)
    elif effect.id == "clipping":
        theta[0] = rng.uniform(0.75, 0.95) * float(np.abs(ideal(stimulus).mag_mgauss).max())
    elif effect.id == "relay_field":
        theta[3], theta[4] = 0.0, float(np.quantile(stimulus.throttle, rng.uniform(0.3, 0.7)))
    return _inside(effect, theta)


def _is_amplitude(parameter: Parameter) -> bool:
    """Tell what may have either sign from moments, and from loads that it begins at."""
    name = parameter.name
    return parameter.low < 0.0 < parameter.high and name not in {*MOMENTS, "reference_degc", "threshold"}


def scaled(setting: Setting, factor: float) -> Setting:
    """Make an effect weaker or stronger by its amplitudes."""
    theta = setting.theta.copy()
    for i, p in enumerate(setting.effect.parameters):
        place = setting.effect.id == "spatial_dipole" and p.unit in ("m", "s")
        late = p.name in ("lag_s", "time_constant_s") or setting.effect.id == "eddy_current"
        if (_is_amplitude(p) and not place) or late:
            theta[i] *= factor
    return _inside(setting.effect, theta)


def _inside(effect: Effect, theta: FloatArray) -> Setting:
    """Keep amplitudes clear of the ends of their ranges, where no diagnosis may name them."""
    moved = np.array([p.scale > 0.0 and not p.optional for p in effect.parameters])
    clear = np.where(moved, _CLEAR, 1.0)
    low = np.where(effect.lower < 0.0, effect.lower * clear, effect.lower)
    return Setting(effect, np.clip(theta, low, effect.upper * clear))


def size_sigma(stimulus: Stimulus, settings: Sequence[Setting]) -> float:
    """Return the detectability d: the whitened length of the shift that effects make."""
    before, after = ideal(stimulus), affected(stimulus, settings)
    changes = {g: group_values(after, g) - group_values(before, g) for g in GROUPS}
    return math.sqrt(sum(float((CASE_NOISE[g].whiten(change) ** 2).sum()) for g, change in changes.items()))


def to_size(stimulus: Stimulus, setting: Setting, wanted: float) -> Setting:
    """Scale an effect until it has about the wanted detectability."""
    for _ in range(4):
        size = size_sigma(stimulus, [setting])
        if size <= 0.0:
            break
        setting = scaled(setting, wanted / size)
    return setting


def draw_label(seed: int, index: int, tier: Tier | None = None) -> Label:
    """Draw one case."""
    rng = np.random.default_rng([seed, index, 77])
    shares = SHARES["bench"]
    chosen: Tier = tier or rng.choice(list(shares), p=list(shares.values()))
    motion: Motion = MOTIONS[int(rng.integers(3))]
    recipe = Recipe(motion, seed=int(rng.integers(2**31)))
    stimulus = stimulus_of(recipe)
    count = {"none": 0, "pair": 2}.get(chosen, 1)
    usable = usable_effects(stimulus)
    if chosen != "single":
        usable = [e for e in usable if e.id not in _FOUND_BY_TRACE]
    picked = [usable[int(i)] for i in rng.choice(len(usable), count, replace=False)]
    settings = []
    for effect in picked:
        setting = draw_setting(effect, stimulus, rng)
        fixed = effect.kind != "mean" or effect.id == "clipping"
        wanted = math.exp(rng.uniform(*np.log(_SIZES)))
        settings.append(setting if fixed else to_size(stimulus, setting, wanted))
    size = size_sigma(stimulus, settings) if settings else 0.0
    return Label(chosen, motion, recipe.seed, tuple(spell(s) for s in settings), size)


def recipe_of(label: Label) -> Recipe:
    """Return the motion of a label."""
    return Recipe(cast(Motion, label.motion), seed=label.seed)


def tracks_of(label: Label) -> tuple[Track, Track]:
    """Make the recording of a label, and a baseline of the same kind of motion without effects."""
    stimulus = stimulus_of(recipe_of(label))
    settings = [parse(text) for text in label.effects]
    rng = np.random.default_rng([label.seed, 3])
    early = [s for s in settings if s.effect.stage is not Stage.SENSOR]
    late = [s for s in settings if s.effect.stage is Stage.SENSOR]
    reading = noisy(Distortion(early).apply(stimulus, ideal(stimulus), rng), rng)
    reading = Distortion(late).apply(stimulus, reading, rng)
    before = stimulus_of(replace(recipe_of(label), seed=label.seed ^ 0x5EED))
    baseline = noisy(ideal(before), np.random.default_rng([label.seed, 4]))
    return to_track(stimulus, reading), to_track(before, baseline, "baseline")


def draw_case(seed: int, index: int, tier: Tier | None) -> tuple[Label, Track, Track]:
    """Draw one case: its label, the recording and the baseline."""
    label = draw_label(seed, index, tier)
    return label, *tracks_of(label)


def noiseless(label: Label) -> tuple[Problem, list[Effect]]:
    """Return the recording of a label without noise, and the effects that a diagnosis could choose."""
    stimulus = stimulus_of(recipe_of(label))
    replayed = replay(to_track(stimulus, affected(stimulus, [parse(text) for text in label.effects])))
    return Problem(replayed, CASE_NOISE, replayed.valid, Prior.of(())), list(catalogue().values())
