"""What a drastic cause must show by itself: on recordings of the simulation, cut and loaded by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mavcompass.frames import FloatArray
from mavcompass.gap.fit import Fit, Problem, make_term
from mavcompass.gap.replay import Prior, replay
from mavcompass.gap.selection.direct import goes_with_a_load, unswitched
from mavcompass.gap.trial.cases import CASE_NOISE, Recipe, make_track
from mavcompass.simulation.effects import parse
from mavcompass.simulation.effects.effect import NEVER_S
from mavcompass.track import Series, Track

RECIPE = Recipe("rich", duration_s=60.0, rate_hz=10.0, seed=3)
THROTTLE = "source=0"


def recorded(*effects: str, throttle: FloatArray | None = None) -> Problem:
    """Return a problem on a recording with effects; its only load is the throttle."""
    track: Track = make_track(RECIPE, [parse(e) for e in effects])
    if throttle is not None:
        assert track.throttle is not None
        track = replace(
            track, throttle=Series.of(track.throttle.time_s, throttle), current_a=None, motors=None
        )
    replayed = replay(track)
    return Problem(replayed, CASE_NOISE, replayed.valid, Prior.of(replayed.nuisances))


def said(problem: Problem, *effects: str) -> Fit:
    """Return a fit that says that these effects are there, and knows everything else."""
    settings = [parse(e) for e in effects]
    terms = tuple(make_term(s.effect, problem.replay.signals) for s in settings)
    known = tuple(n.mean for n in problem.nuisances)
    return Fit(terms, tuple(s.theta for s in settings), known, np.inf)


@pytest.mark.parametrize("size", [8.0, 40.0, 300.0])
def test_what_is_switched_changes_readings_when_it_is(size: float) -> None:
    relay = f"relay_field:x={size},y=0,z={-size},{THROTTLE},threshold=0.45"
    problem = recorded(relay)
    assert not unswitched(problem, said(problem, relay))


@pytest.mark.parametrize("threshold", [0.3, 0.45, 0.6])
def test_a_constant_is_nothing_that_is_switched(threshold: float) -> None:
    problem = recorded("hard_iron:x=50,y=0,z=-90")
    relay = said(problem, f"relay_field:x=50,y=0,z=-90,{THROTTLE},threshold={threshold}")
    assert unswitched(problem, relay)


def test_what_is_never_switched_is_not_told_by_its_switching() -> None:
    problem = recorded("hard_iron:x=50")
    assert not unswitched(problem, said(problem, f"relay_field:x=50,{THROTTLE},threshold=-1"))
    assert not unswitched(problem, said(problem, "hard_iron:x=50"))


def test_a_small_relay_among_noise_is_not_refused() -> None:
    """Two milligauss beside three of noise: its switchings say nothing for sure, the whole recording may."""
    relay = f"relay_field:x=2,y=0,z=0,{THROTTLE},threshold=0.45"
    problem = recorded(relay)
    assert not unswitched(problem, said(problem, relay))


def running(start_s: float, end_s: float) -> FloatArray:
    time = np.arange(600) / 10.0
    return np.where((time >= start_s) & (time < end_s), 0.5, 0.02)


@pytest.mark.parametrize(
    ("on_s", "off_s", "of_the_load"),
    [
        (20.0, 45.0, True),
        (20.6, 44.5, True),  # a rare record of the load, a motor that takes its time
        (20.0, NEVER_S, False),
        (10.0, 45.0, False),
        (30.0, 35.0, False),
    ],
)
def test_an_iron_that_is_there_while_the_motors_run_is_their_field(
    on_s: float, off_s: float, of_the_load: bool
) -> None:
    step = f"hard_iron_step:x=40,on_s={on_s},off_s={off_s}"
    problem = recorded(step, throttle=running(20.0, 45.0))
    assert goes_with_a_load(problem, said(problem, step)) is of_the_load


def test_an_iron_that_is_there_while_the_motors_rest_goes_with_them_too() -> None:
    """Landed or parked on something: it is the load's as far as this recording tells."""
    problem = recorded("hard_iron_step:x=40,on_s=45,off_s=1e7", throttle=running(0.0, 45.0))
    assert goes_with_a_load(problem, said(problem, "hard_iron_step:x=40,on_s=45,off_s=1e7"))


def test_without_a_varying_load_a_step_is_a_step() -> None:
    problem = recorded("hard_iron_step:x=40,on_s=20,off_s=45", throttle=np.full(600, 0.3))
    assert not goes_with_a_load(problem, said(problem, "hard_iron_step:x=40,on_s=20,off_s=45"))
    assert not goes_with_a_load(problem, said(problem, "hard_iron:x=40"))
