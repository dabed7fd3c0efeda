"""Derivatives of a composed simulation against differences of the whole simulation."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from mavcompass.gap.fit.composition import Composition
from mavcompass.gap.fit.hypothesis import Fit, make_term
from mavcompass.gap.replay.nominal import Replay, replay
from mavcompass.gap.residual.floor import STATED, prior_of
from mavcompass.gap.trial.vehicles import make_case
from mavcompass.simulation.effects import catalogue

_WITH = {
    "axis_scale": {"x": 0.08, "y": -0.05, "on_iron": 1.0},
    "soft_iron": {"xx": 0.05, "xy": -0.03},
    "misalignment": {"x": 0.04, "z": -0.06},
    "hard_iron": {"x": 30.0, "z": -20.0},
    "low_pass": {"time_constant_s": 0.1},
    "clipping": {"limit_mgauss": 520.0},
    "inclination": {"angle_rad": 0.05},
    "transport_lag": {"lag_s": 0.12},
    "spatial_dipole": {
        "moment_north": 40.0,
        "moment_down": -30.0,
        "north_m": 6.0,
        "east_m": -4.0,
        "down_m": 1.0,
    },
    "eddy_current": {"x": 0.05, "y": 0.04, "z": 0.06},
    "accel_bias": {"x": 0.1, "y": -0.05},
}


@cache
def flight() -> Replay:
    return replay(make_case(4, "none", baseline=False).track)


@pytest.mark.parametrize(
    ("names", "share"),
    [
        ((), 0.003),
        (("axis_scale", "hard_iron"), 0.003),
        (("soft_iron", "misalignment", "inclination"), 0.003),
        (("spatial_dipole", "hard_iron"), 0.003),
        (("spatial_dipole", "transport_lag"), 0.02),
        (("hard_iron", "transport_lag"), 0.01),
        (("eddy_current", "hard_iron"), 0.003),
        (("hard_iron", "low_pass"), 0.01),
        (("axis_scale", "clipping"), 0.06),
        (("low_pass", "hard_iron", "clipping"), 0.06),
        # Of another sensor, behind an age and a mean that are reckoned together.
        (("hard_iron", "accel_bias"), 0.003),
    ],
)
def test_each_derivative_is_the_difference_that_a_small_step_makes(
    names: tuple[str, ...], share: float
) -> None:
    at = flight()
    prior = prior_of(at, STATED)
    composition = Composition(at, prior)
    terms = [make_term(catalogue()[name], at.signals) for name in names]
    thetas = []
    for term, name in zip(terms, names, strict=True):
        theta = term.effect.neutral()
        for key, value in _WITH[name].items():
            theta[term.effect.names.index(key)] = value
        thetas.append(theta)
    known = [prior.mean[place] for place in prior.places.values()]
    everything = [*known, *thetas]
    fit = Fit(tuple(terms), tuple(thetas), prior.mean)
    told = composition.changes(fit, composition.states(fit), range(len(everything)))
    column = 0
    for place in range(len(everything)):
        effect = [*prior.effects, *(term.effect for term in terms)][place]
        for j in composition.free(terms, place):
            step = 1e-4 * effect.parameters[j].scale
            ends = []
            for side in (-step, step):
                moved = [x.copy() for x in everything]
                moved[place][j] += side
                ends.append(
                    composition.states(
                        Fit(tuple(terms), tuple(moved[len(known) :]), np.concatenate(moved[: len(known)]))
                    )[-1]
                )
            change = (ends[1].reading.mag_mgauss - ends[0].reading.mag_mgauss) / (2.0 * step)
            error = np.sqrt(np.mean((told["mag"][:, :, column] - change) ** 2))
            size = np.sqrt(np.mean(change**2))
            assert error < share * size + 1e-6, (effect.id, effect.parameters[j].name, error, size)
            column += 1
    assert column == told["mag"].shape[2]


@pytest.mark.parametrize("name", ["transport_lag", "hard_iron", "low_pass"])
def test_what_is_held_has_no_derivative(name: str) -> None:
    """A delay beside the age of the telemetry, with which it is reckoned together, as anything else."""
    at = flight()
    prior = prior_of(at, STATED)
    assert "telemetry age" in prior.places
    composition = Composition(at, prior)
    term = make_term(catalogue()[name], at.signals)
    held = replace(term, free=np.zeros_like(term.free))
    counts = []
    for one in (term, held):
        fit = Fit((one,), (term.effect.neutral(),), prior.mean)
        told = composition.changes(fit, composition.states(fit), range(len(prior.effects) + 1))
        counts.append(told["mag"].shape[2])
    assert counts[0] - counts[1] == np.count_nonzero(term.free)
