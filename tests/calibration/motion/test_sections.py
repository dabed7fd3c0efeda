"""How a motion is cut, and what its sections leave unknown."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mavcompass.calibration.motion import sections
from mavcompass.calibration.observation import wire

TIME = np.arange(0.0, 20.0, 0.1)
STILL, LEVEL = np.zeros(TIME.size), np.tile([0.0, 0.0, 1.0], (TIME.size, 1))


def cut(**changed: np.ndarray) -> tuple[list[float], list[int]]:
    """Return when sections begin, and which visit of a heading each belongs to."""
    values = {"time": TIME, "angle": STILL, "down": LEVEL, "load": STILL, **changed}
    edges, visit = sections._edges(values["time"], values["angle"], values["down"], values["load"])
    assert edges[-1] == values["time"].size
    return [round(float(values["time"][k]), 1) for k in edges[:-1]], visit.tolist()


def test_what_stands_is_one_visit_in_sections_of_five_seconds() -> None:
    begins, visits = cut()
    assert begins == pytest.approx([0.0, 5.1, 10.2, 15.3], abs=0.15) and visits == [0, 0, 0, 0]


@pytest.mark.parametrize(("deg", "is_cut"), [(19.9, False), (20.1, True), (-20.1, True)])
def test_a_turn_of_twenty_degrees_begins_another(deg: float, is_cut: bool) -> None:
    begins, visits = cut(angle=np.where(TIME < 3.0, 0.0, math.radians(deg)))
    assert (begins[1] == 3.0) is is_cut and visits[-1] == is_cut


@pytest.mark.parametrize(("deg", "is_cut"), [(6.9, False), (7.2, True)])
def test_a_lean_of_seven_degrees_begins_another(deg: float, is_cut: bool) -> None:
    lean = math.radians(deg)
    leant = np.where(TIME[:, np.newaxis] < 3.0, LEVEL, [math.sin(lean), 0.0, math.cos(lean)])
    begins, visits = cut(down=leant)
    assert (begins[1] == 3.0) is is_cut and visits[-1] == is_cut


@pytest.mark.parametrize(("amperes", "is_cut"), [(1.4, False), (1.6, True), (-1.6, True)])
def test_a_load_of_a_seventh_of_its_range_begins_another(amperes: float, is_cut: bool) -> None:
    load = np.where(TIME < 3.0, 0.0, amperes)
    load[-5:] = 10.0 if amperes > 0.0 else 10.0 + amperes  # the whole range is 10
    begins, _ = cut(load=load)
    assert (begins[1] == 3.0) is is_cut


@pytest.mark.parametrize(("gap_s", "is_cut"), [(0.9, False), (1.2, True)])
def test_a_gap_begins_another(gap_s: float, is_cut: bool) -> None:
    time = np.where(TIME < 2.95, TIME, TIME + gap_s - 0.1)
    begins, visits = cut(time=time)
    assert (begins[1] < 5.0) is is_cut and visits[-1] == is_cut


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


@pytest.mark.parametrize(("interval_s", "times"), [(0.02, 1.0), (0.1, 1.0), (0.3, 3.0), (5.0, 5.0)])
def test_a_turn_heard_too_seldom_is_less_certain(interval_s: float, times: float) -> None:
    record: Any = SimpleNamespace(interval_s=interval_s, independent_sigma_rad=lambda a, b: 0.01 * (b - a))
    assert sections._step_sigma(record, 3.0, 5.0) == pytest.approx(0.02 * times)
    record.independent_sigma_rad = lambda a, b: 0.0
    assert sections._step_sigma(record, 3.0, 5.0) == pytest.approx(math.radians(0.02))
    record.independent_sigma_rad = lambda a, b: 9.0
    assert sections._step_sigma(record, 3.0, 5.0) == math.pi


def test_the_noise_is_that_beside_a_smooth_turn() -> None:
    chance = np.random.default_rng(6)
    turn = 200.0 * np.stack([np.cos(TIME), np.sin(TIME), 2.0 + 0.0 * TIME], axis=1)
    noisy = turn + 2.0 * chance.normal(size=turn.shape)
    assert sections._white_noise(TIME, noisy, 0.0) == pytest.approx(2.0, rel=0.1)
    still = np.zeros_like(turn)
    assert sections._white_noise(TIME, still, 0.0) == pytest.approx(0.2)
    assert sections._white_noise(TIME, still, 1.0) == pytest.approx(math.hypot(0.2, math.sqrt(1.0 / 12.0)))
    assert sections._white_noise(TIME[:7], noisy[:7], 0.0) == 3.0  # too few to tell
    assert sections._white_noise(2.1 * TIME, noisy, 0.0) == 3.0  # too far apart


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


@pytest.mark.parametrize(
    "changed",
    [
        {"angle": np.where(TIME < 0.05, 0.0, math.radians(-25.0))},
        {"angle": np.where(TIME < 0.05, 0.0, math.radians(25.0))},
        {"load": np.where(TIME < 0.05, 0.0, np.where(TIME < 19.0, 2.0, 10.0))},
        {"down": np.where(TIME[:, np.newaxis] < 0.05, [0.2, 0.0, 0.98], LEVEL)},
    ],
)
def test_what_changes_after_the_first_reading_begins_another(changed: dict[str, np.ndarray]) -> None:
    begins, visits = cut(**changed)
    assert begins[1] == 0.1 and visits[:2] == [0, 1]


@pytest.mark.parametrize(("swings", "is_widened"), [(160, False), (161, True)])
def test_no_more_than_160_sections_are_cut(swings: int, is_widened: bool) -> None:
    """It swings by thirty degrees every half a second; wider limits let several swings be one section."""
    time = np.arange(0.0, 0.5 * swings - 0.05, 0.1)
    swing = np.floor(time / 0.5 + 1e-6) % 2.0
    begins, visits = cut(
        time=time, angle=math.radians(30.0) * swing, down=np.tile(LEVEL[0], (time.size, 1)), load=0.0 * time
    )
    assert (len(begins) < 160) is is_widened and (len(visits) == 160) is not is_widened


def test_nothing_and_one_reading_make_no_section() -> None:
    for count in (0, 1):
        edges, visit = sections._edges(TIME[:count], STILL[:count], LEVEL[:count], STILL[:count])
        assert edges.tolist() == [0] and visit.tolist() == []
    edges, visit = sections._edges(TIME[:2], STILL[:2], LEVEL[:2], STILL[:2])
    assert edges.tolist() == [0, 2] and visit.tolist() == [0]
