"""How a motion is cut, and what its sections leave unknown."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mavcompass.calibration.motion import sections
from mavcompass.calibration.observation import wire
from mavcompass.correction import FieldCorrection
from mavcompass.track import InForce, MagSeries, Series, Track

TIME = np.arange(0.0, 20.0, 0.1)
STILL, LEVEL = np.zeros(TIME.size), np.tile([0.0, 0.0, 1.0], (TIME.size, 1))


def cut(**changed: np.ndarray) -> tuple[list[float], list[int]]:
    """Return when sections begin, and which visit of a heading each belongs to."""
    values = {"time": TIME, "angle": STILL, "down": LEVEL, "load": STILL, **changed}
    edges, visit = sections._edges(values["time"], values["angle"], values["down"], values["load"])
    assert edges[-1] == values["time"].size
    return [round(float(values["time"][k]), 1) for k in edges[:-1]], visit.tolist()


def test_a_gap_begins_another() -> None:
    begins, visits = cut(time=np.where(TIME < 2.95, TIME, TIME + 1.1))
    assert 2.9 < begins[1] < 4.2 and visits[-1] >= 1


def test_readings_around_a_change_of_the_parameters_are_unsettled() -> None:
    steps = tuple(InForce(t, FieldCorrection()) for t in (-math.inf, 5.0, 15.0))
    field = Series.of(TIME, np.zeros((TIME.size, 3)))
    found = TIME[sections.unsettled(Track(compasses={1: MagSeries(1, field, steps)}), 1)]
    assert found.min() == pytest.approx(3.1) and found.max() == pytest.approx(16.9) and found.size == 2 * 39
    assert not sections.unsettled(Track(compasses={1: MagSeries(1, field)}), 1).any()


LONG = np.arange(0.0, 800.0, 0.1)
CHANCE = np.random.default_rng(1)
RESTLESS = {
    "turns": {"angle": np.radians(10.0) * LONG},
    "leans": {
        "down": np.stack([np.cos(0.1 * LONG), np.sin(0.1 * LONG), 0.0 * LONG + 1.0], 1) / math.sqrt(2.0)
    },
    "draws current": {"load": np.repeat(CHANCE.uniform(0.0, 10.0, LONG.size // 25), 25)},
    "is heard now and then": {
        "time": LONG + np.repeat(np.cumsum(CHANCE.uniform(0.5, 9.0, LONG.size // 20)), 20)
    },
}


@pytest.mark.parametrize("what", RESTLESS)
def test_what_never_rests_is_cut_more_coarsely_but_no_more_than_need_be(what: str) -> None:
    changed = RESTLESS[what]
    time = changed.get("time", LONG)
    rest = {"time": time, "angle": 0.0 * time, "down": np.tile(LEVEL[0], (time.size, 1)), "load": 0.0 * time}
    begins, _ = cut(**{**rest, **changed})
    assert 110 <= len(begins) <= 160


def test_a_whole_number_that_does_not_move_hides_its_step_on_that_axis() -> None:
    rng = np.random.default_rng(6)
    true = rng.uniform(100.0, 120.0, (300, 3))
    ramp = np.linspace(0.0, 30.0, 40)
    rows = true[:, np.newaxis, :] + np.array([1.0, 0.3, 0.0]) * ramp[:, np.newaxis]  # along x and y, not z
    values = np.trunc(rows.reshape(-1, 3))
    first = np.arange(0, len(values), ramp.size)
    hidden = wire.hidden_in_runs(values, first, 1.0)
    means = np.add.reduceat(values, first) / ramp.size + 0.5
    off = (means - rows.mean(axis=1)).std(axis=0)
    claimed = np.sqrt((hidden**2).mean(axis=0))
    assert off[2] == pytest.approx(claimed[2], rel=0.1) and claimed[2] == pytest.approx(1.0 / math.sqrt(12.0))
    assert claimed[0] < claimed[1] < 0.15 and (off[:2] < claimed[:2]).all()
    assert not wire.hidden_in_runs(values, first, 0.0).any()
