"""A compass in another orientation is looked for beside what else is there."""

from __future__ import annotations

import numpy as np
import pytest

from mavcompass.gap.fit.hypothesis import Fit, make_term
from mavcompass.gap.fit.model import Problem
from mavcompass.gap.fit.search import facing
from mavcompass.gap.replay.nominal import replay
from mavcompass.gap.trial.cases import CASE_NOISE, Recipe, make_track
from mavcompass.simulation.effects import parse, registry

MAGNET = "spatial_dipole:north_m=1.5,east_m=0.5,down_m=1.4,moment_north=700,moment_east=700,moment_down=700"


def problem_and_magnet(turn: int) -> tuple[Problem, Fit]:
    """Return a recording of a turned compass that passes a magnet, and a fit that knows the magnet."""
    effects = [parse(MAGNET), parse(f"orientation:orientation={turn}")]
    replayed = replay(make_track(Recipe("rich", duration_s=60.0, rate_hz=8.0, seed=6), effects))
    problem = Problem(replayed, CASE_NOISE, replayed.valid, replayed.prior)
    term = make_term(effects[0].effect, replayed.signals)
    return problem, Fit((term,), (effects[0].theta,), problem.prior.mean, np.inf)


@pytest.mark.parametrize("turn", [4, 10, 14])
def test_a_turn_that_a_magnet_hides_is_seen_beside_the_magnet(turn: int) -> None:
    problem, magnet = problem_and_magnet(turn)
    terms = [make_term(registry.get("orientation"), problem.replay.signals)]
    nothing = Fit((), (), magnet.nuisances, np.inf)
    beside = min(facing(problem, terms, magnet, np.inf), key=lambda f: f.sse)
    by_itself = min(facing(problem, terms, nothing, np.inf), key=lambda f: f.sse)
    assert beside.ids == {"orientation", "spatial_dipole"} and beside.value("orientation") == turn
    noise = 3 * len(problem.groups) * problem.count
    assert beside.sse < 1.2 * noise < 0.01 * by_itself.sse
    # What may leave no less than there is without it is not fitted to its end.
    assert facing(problem, terms, magnet, 0.0) == []
