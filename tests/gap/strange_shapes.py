"""Disturbances that the catalogue does not hold, and how often the diagnosis owns up to not knowing them.

    .venv/bin/python tests/gap/strange_shapes.py --cases 200 --seed 9001

They are kept with the tests, where the diagnosis cannot learn them. A case counts where it is at least 12
sigmas away from all that three effects of the catalogue can make together (d_perp).
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from mavcompass.blas import single_thread
from mavcompass.chance import wilson
from mavcompass.frames import FloatArray
from mavcompass.gap import diagnose_gap
from mavcompass.gap.fit.model import Problem
from mavcompass.gap.fit.search import Search
from mavcompass.gap.replay.nominal import replay
from mavcompass.gap.trial.cases import CASE_NOISE, Recipe, noisy, stimulus_of, to_track
from mavcompass.simulation.effects import catalogue
from mavcompass.simulation.physics.signals import Reading, Stimulus, ideal

Shape = Callable[[Stimulus, FloatArray, np.random.Generator], FloatArray]
FLAGGED = ("unknown", "named_with_remainder", "ambiguous")


def _along(wave: FloatArray, rng: np.random.Generator) -> FloatArray:
    direction = rng.normal(size=3)
    return np.asarray(wave[:, None] * direction / np.linalg.norm(direction))


def _part(s: Stimulus) -> FloatArray:
    return np.asarray((s.time_s - s.time_s[0]) / (s.time_s[-1] - s.time_s[0]))


def _chirp(s: Stimulus, field: FloatArray, rng: np.random.Generator) -> FloatArray:
    start, speed = rng.uniform(0.03, 0.1), rng.uniform(0.005, 0.03)
    return _along(np.sin(2.0 * math.pi * (start * s.time_s + 0.5 * speed * s.time_s**2)), rng)


def _decay(s: Stimulus, field: FloatArray, rng: np.random.Generator) -> FloatArray:
    since = _part(s) - rng.uniform(0.15, 0.6)
    return _along(np.where(since > 0.0, np.exp(-np.maximum(since, 0.0) / rng.uniform(0.08, 0.2)), 0.0), rng)


def _sawtooth(s: Stimulus, field: FloatArray, rng: np.random.Generator) -> FloatArray:
    return _along((s.time_s / rng.uniform(7.0, 20.0)) % 1.0 - 0.5, rng)


def _beat(s: Stimulus, field: FloatArray, rng: np.random.Generator) -> FloatArray:
    slow = 1.0 + np.sin(2.0 * math.pi * rng.uniform(0.04, 0.1) * s.time_s)
    return _along(slow * np.sin(2.0 * math.pi * rng.uniform(1.0, 4.0) * s.time_s), rng)


def _heading_wave(s: Stimulus, field: FloatArray, rng: np.random.Generator) -> FloatArray:
    yaw = np.arctan2(s.rotation[:, 1, 0], s.rotation[:, 0, 0])
    return _along(np.sin(float(rng.integers(3, 6)) * yaw + rng.uniform(0.0, 6.0)), rng)


def _ring(s: Stimulus, field: FloatArray, rng: np.random.Generator) -> FloatArray:
    return np.asarray(np.sin(field[:, [1, 2, 0]] / rng.uniform(30.0, 60.0)))


def _turning(s: Stimulus, field: FloatArray, rng: np.random.Generator) -> FloatArray:
    return _along(np.abs(s.rate_radps[:, 2]), rng)


def _drift(s: Stimulus, field: FloatArray, rng: np.random.Generator) -> FloatArray:
    return _along(_part(s) ** rng.uniform(1.5, 3.0), rng)


def _memory_across(s: Stimulus, field: FloatArray, rng: np.random.Generator) -> FloatArray:
    width, held, kept = rng.uniform(30.0, 70.0), field[0, 0], np.empty(len(field))
    for i, value in enumerate(field[:, 0]):
        held = min(max(held, value - width), value + width)
        kept[i] = held
    out = np.zeros_like(field)
    out[:, 1] = (field[:, 0] - kept) / width
    return out


def _bursts(s: Stimulus, field: FloatArray, rng: np.random.Generator) -> FloatArray:
    on = np.sin(2.0 * math.pi * s.time_s / rng.uniform(12.0, 25.0)) > 0.75
    return np.asarray(rng.standard_normal(field.shape) * on[:, None])


SHAPES: dict[str, Shape] = {
    "chirp": _chirp,
    "decay": _decay,
    "sawtooth": _sawtooth,
    "beat": _beat,
    "heading wave": _heading_wave,
    "ring": _ring,
    "turning": _turning,
    "drift": _drift,
    "memory across axes": _memory_across,
    "bursts": _bursts,
}


def disturbed(name: str, recipe: Recipe, size_sigma: float, seed: int) -> tuple[Stimulus, Reading]:
    """Make noiseless readings with a shape of about so many sigmas."""
    stimulus = stimulus_of(recipe)
    clean = ideal(stimulus)
    shape = SHAPES[name](stimulus, clean.mag_mgauss, np.random.default_rng([seed, 5]))
    whitened = CASE_NOISE["mag"].whiten(shape)
    shape = shape * size_sigma / math.sqrt(float((whitened**2).sum()))
    return stimulus, replace(clean, mag_mgauss=clean.mag_mgauss + shape)


def verdict_on(name: str, recipe: Recipe, size_sigma: float, seed: int) -> str:
    """Diagnose a recording with a shape beside a baseline of the same kind."""
    stimulus, strange = disturbed(name, recipe, size_sigma, seed)
    before = stimulus_of(replace(recipe, seed=recipe.seed + 100_000))
    baseline = to_track(before, noisy(ideal(before), np.random.default_rng([seed, 6])))
    return diagnose_gap(
        to_track(stimulus, noisy(strange, np.random.default_rng([seed, 7]))), baseline
    ).verdict


def novelty(name: str, recipe: Recipe, size_sigma: float, seed: int) -> float:
    """Return d_perp: the distance, in sigmas, to all that three effects of the catalogue can make."""
    replayed = replay(to_track(*disturbed(name, recipe, size_sigma, seed)))
    problem = Problem(replayed, CASE_NOISE, replayed.valid, ())
    with single_thread():
        nearest = Search(problem, list(catalogue().values())).nearest(3)
    return math.sqrt(max(nearest.sse, 0.0))


def main() -> None:
    """Measure the share of strange shapes that are flagged."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=100)
    parser.add_argument("--seed", type=int, required=True)
    arguments = parser.parse_args()
    rng = np.random.default_rng(arguments.seed)
    names, motions = list(SHAPES), ("yaw-steps", "figure-8", "rich")
    flagged = new = 0
    for index in range(arguments.cases):
        name = names[index % len(names)]
        size, seed = math.exp(rng.uniform(math.log(15.0), math.log(150.0))), int(rng.integers(2**30))
        motion = motions[int(rng.integers(3))]
        recipe = Recipe(motion, seed=seed)
        distance = novelty(name, recipe, size, seed)
        if distance < 12.0:
            continue
        verdict = verdict_on(name, recipe, size, seed)
        new += 1
        flagged += verdict in FLAGGED
        if verdict not in FLAGGED:
            print(f"  {name} on {motion}, seed {seed}, d {size:.0f}, d_perp {distance:.1f}: {verdict}")
    low, high = wilson(flagged, new)
    print(f"flagged {flagged}/{new} (95 % {100 * low:.1f} .. {100 * high:.1f}), seed {arguments.seed}")


if __name__ == "__main__":
    main()
