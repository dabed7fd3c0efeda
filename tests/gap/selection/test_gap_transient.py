"""Rows that are set aside while something changes, and what a remainder's noise is."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mavcompass.frames import FloatArray
from mavcompass.gap.fit.hypothesis import Fit, Term
from mavcompass.gap.replay.noise import white
from mavcompass.gap.replay.nuisance import AGE, Prior
from mavcompass.gap.selection import identification
from mavcompass.gap.selection import split as transient
from mavcompass.gap.selection.split import Split, probe, split_blocks, with_windows
from mavcompass.simulation.effects import registry
from mavcompass.simulation.effects.effect import NEVER_S

TIME = np.arange(400.0) * 0.05  # 20 s


def changing(on_s: float, off_s: float = NEVER_S) -> Fit:
    effect = registry.get("hard_iron_step")
    low, high = (np.array([getattr(p, side) for p in effect.parameters]) for side in ("low", "high"))
    values = {"x": 30.0, "on_s": on_s, "off_s": off_s}
    theta = np.array([values.get(p.name, 0.0) for p in effect.parameters])
    return Fit((Term(effect, np.ones(low.size, dtype=np.bool_), low, high),), (theta,), (), 0.0)


@dataclass
class Problem:
    """Have innovations of size 1, and larger ones while something changes."""

    during: tuple[float, float]
    size: float
    usable: Any = field(default_factory=lambda: np.ones(TIME.size, dtype=np.bool_))

    replay = SimpleNamespace(time_s=TIME)

    def predict(self, fit: Fit) -> Any:
        return None

    def innovations(self, reading: Any) -> dict[str, FloatArray]:
        z = np.ones((TIME.size, 3))
        z[(TIME >= self.during[0]) & (TIME < self.during[1])] *= self.size
        return {"mag": z}


def test_moments_are_the_times_at_which_something_changes() -> None:
    assert transient.moments(changing(7.5)) == [7.5]
    assert transient.moments(changing(7.5, 12.0)) == [7.5, 12.0]
    assert transient.moments(Fit((), (), (), 0.0)) == []


def aside(problem: Problem, *when_s: float) -> list[float]:
    rows = transient.transients(problem, changing(10.0), when_s)  # type: ignore[arg-type]
    return [round(float(t), 2) for t in TIME[rows][[0, -1]]] if rows.any() else []


def test_what_changes_for_a_while_is_set_aside_with_a_little_on_both_sides() -> None:
    assert aside(Problem((10.0, 11.0), 5.0), 9.99) == [9.75, 11.2]
    assert aside(Problem((9.0, 10.0), 5.0), 9.99) == [8.75, 10.2]
    assert aside(Problem((9.5, 10.5), 5.0), 9.99) == [9.25, 10.7]
    assert aside(Problem((10.0, 11.0), 5.0)) == aside(Problem((10.0, 11.0), 5.0), 4.0) == []
    # Three seconds at most, and only what is four times as large in the square.
    assert aside(Problem((10.0, 16.0), 5.0), 9.99) == [9.75, 13.2]
    # Their median would be that of noise whose mean square is 1.27.
    assert aside(Problem((10.0, 11.0), 2.2), 10.0) == [] and aside(Problem((10.0, 11.0), 2.3), 10.0) != []


def test_rows_that_are_not_used_change_nothing() -> None:
    none = np.zeros(TIME.size, dtype=np.bool_)
    assert aside(Problem((10.0, 11.0), 5.0, none), 10.0) == []
    gap = (TIME < 10.0) | (TIME >= 10.3)
    assert aside(Problem((10.0, 11.0), 5.0, gap), 10.0) == []


def test_between_fitted_rows_any_moment_fits() -> None:
    problem: Any = SimpleNamespace(replay=SimpleNamespace(time_s=TIME), index=np.array([20, 40, 60]))
    assert transient.between_rows(problem, 1.7) == (1.0, 2.0)
    assert transient.between_rows(problem, 2.0) == (2.0, 3.0)
    assert transient.between_rows(problem, 0.5) == (0.5, 1.0) and transient.between_rows(problem, 9.0) == (
        3.0,
        9.0,
    )
    put = transient.with_moments(problem, changing(1.7), [1.2, 2.4])
    assert transient.moments(put) == [1.2]
    for row_s in (1.0, 2.0):  # a row at the moment itself does not lie between
        assert transient.moments(transient.with_moments(problem, changing(1.7), [row_s])) == [row_s]
    assert transient.moments(transient.with_moments(problem, changing(2.1), [1.2])) == [
        2.1
    ]  # a row lies between
    assert transient.moments(transient.with_moments(problem, changing(1.7), [])) == [1.7]
    assert put.thetas[0][0] == 30.0


def switching(
    load: FloatArray, late_s: float = 0.0, every_s: float = 0.0, smoothed_s: float = 0.0
) -> FloatArray:
    """Return the times that something switched above half of a load leaves out."""
    effect = registry.get("relay_field")
    low, high = (np.array([getattr(p, side) for p in effect.parameters]) for side in ("low", "high"))
    theta = np.array([30.0, 0.0, 0.0, 0.0, 0.5])
    age = Prior.of(AGE, np.array([late_s]), np.ones(1))
    terms, thetas = [Term(effect, np.ones(low.size, dtype=np.bool_), low, high)], [theta]
    if smoothed_s:
        one = np.ones(1)
        terms.append(Term(registry.get("low_pass"), one > 0.0, one, one))
        thetas.append(smoothed_s * one)
    fit = Fit(tuple(terms), tuple(thetas), (age.mean,), 0.0)
    stimulus = SimpleNamespace(throttle=load)

    class Still:
        def __init__(self, mag: FloatArray | None = None) -> None:
            self.stimulus, self.reading = stimulus, SimpleNamespace(mag_mgauss=mag)

        def with_mag(self, mag: FloatArray) -> Still:
            return Still(mag)

    as_predicted = SimpleNamespace(mag_mgauss=np.zeros((TIME.size, 3)))
    replay = SimpleNamespace(time_s=TIME, signals=Still(), loads_every_s=every_s, measured=as_predicted)
    usable = np.ones(TIME.size, dtype=np.bool_)
    problem: Any = SimpleNamespace(
        replay=replay, values=lambda fit: {AGE.id: age.mean}, usable=usable, predict=lambda fit: as_predicted
    )
    return TIME[transient.switched(problem, fit)]


def test_readings_about_a_switching_are_set_aside_unless_there_are_too_many() -> None:
    once = np.where(TIME >= 10.0, 1.0, 0.0)
    # Between 9.95 and 10 s; a load is known to a tenth of a second.
    assert switching(once) == pytest.approx([9.9, 9.95, 10.0, 10.05])
    assert switching(once, late_s=0.1) == pytest.approx([10.0, 10.05, 10.1, 10.15])
    assert switching(once, every_s=0.2) == pytest.approx(np.arange(9.8, 10.16, 0.05))  # or to a fifth
    assert switching(np.zeros(TIME.size)).size == 0
    often = np.where(np.floor(TIME / 0.65) % 2 == 0, 1.0, 0.0)
    assert 0.25 * TIME.size < switching(often).size < 0.4 * TIME.size
    # A low pass goes on after each switching, to a twentieth in three of its time constants.
    assert switching(once, smoothed_s=0.1) == pytest.approx(np.arange(9.6, 10.36, 0.05))
    assert switching(np.where(np.floor(TIME / 0.25) % 2 == 0, 1.0, 0.0)).size == 0


def other_way(
    off: FloatArray, rows: Sequence[int], size_mgauss: float = 50.0, shared: Sequence[int] = ()
) -> list[int]:
    """Return the rows that were switched the other way, of those that are off by `off`, mG."""
    own = size_mgauss * np.array([0.6, -0.8, 0.0])
    on = TIME >= 10.0
    error = np.random.default_rng(4).normal(0.0, 2.0, (TIME.size, 3))
    error[list(rows)] += off
    reading = SimpleNamespace(mag_mgauss=np.where(on[:, None], own, 0.0))
    replay = SimpleNamespace(measured=SimpleNamespace(mag_mgauss=reading.mag_mgauss + error))
    problem: Any = SimpleNamespace(
        replay=replay, usable=np.ones(TIME.size, dtype=np.bool_), predict=lambda fit: reading
    )
    told = transient._other_way(
        problem, Fit((), (), (), 0.0), reading.mag_mgauss, own, np.isin(np.arange(TIME.size), shared)
    )
    return np.flatnonzero(told).tolist()


def test_a_load_that_comes_and_goes_between_two_records_shows_in_the_readings() -> None:
    own = 50.0 * np.array([0.6, -0.8, 0.0])
    late, early = TIME.size - 20, 20  # on, and off
    assert other_way(-own, [late, late + 7]) == [late, late + 7]
    assert other_way(0.5 * own, [early]) == [early]  # for half of the reading
    assert other_way(own, [late]) == [] and other_way(-own, [early]) == []  # more than on, less than off
    assert other_way(-1.6 * own, [late]) == []
    assert other_way(np.array([40.0, 30.0, 0.0]), [early]) == []  # across
    many = list(range(0, 60, 2)) + list(range(60, 150))
    assert other_way(own, [row for row in many if TIME[row] < 10.0]) == []  # another thing switches it
    # Beside a switching a reading may lie on either side.
    assert other_way(own, range(0, 90), shared=range(0, 85)) == list(range(0, 90))
    small = 8.0 * np.array([0.6, -0.8, 0.0])
    assert other_way(small, [early], 8.0) == []  # as noise does


def test_what_was_set_aside_is_told_stretch_by_stretch() -> None:
    replay: Any = SimpleNamespace(time_s=TIME)
    rows = ((TIME > 1.99) & (TIME < 3.01)) | (TIME > 18.99)
    never = 0 * rows == 1
    first, second = transient.said_of(replay, rows, never)
    assert first.startswith("From 2.0 to 3.0 s something changes faster") and second.startswith(
        "From 19.0 to 20.0"
    )
    assert transient.said_of(replay, never, never) == ()
    (often,) = transient.said_of(replay, never, rows)
    assert often.startswith("While something is switched") and f" {rows.sum()} of 400 " in often


# --- blocks ------------------------------------------------------------------------------------------


def whole(seconds: float) -> tuple[FloatArray, Split]:
    time = np.arange(0.0, seconds, 0.1)
    return time, split_blocks(time, np.ones(time.size, dtype=np.bool_))


def test_one_block_of_four_is_held_out_and_no_two_neighbours() -> None:
    _, split = whole(400.0)
    held = split.test.reshape(80, 50).all(axis=1)
    assert 50 * held.sum() == split.test.sum() and 17 <= held.sum() <= 20
    assert not (held[1:] & held[:-1]).any()
    assert split_blocks(np.array([0.0, 0.0001]), np.ones(2, dtype=np.bool_)).train.size == 2


def test_a_guard_lies_beside_held_out_blocks() -> None:
    time, split = whole(400.0)
    edges = np.abs(np.diff(split.test.astype(int))).sum()
    assert time.size - split.train.sum() - split.test.sum() == edges * 5  # half a second
    some = np.arange(time.size) % 2 == 0
    half = split_blocks(time, some)
    assert not (half.train | half.test)[~some].any() and half.test.sum() == 0.5 * split.test.sum()


def test_a_window_brings_training_rows_and_keeps_its_distance() -> None:
    time, split = whole(400.0)
    valid = np.ones(time.size, dtype=np.bool_)
    valid[::7] = False
    middle = float(time[split.test][20])
    narrowed = with_windows(split, time, valid, [middle])
    distance = np.abs(time - middle)
    assert (narrowed.train[distance < 0.29] == valid[distance < 0.29]).all()
    assert not narrowed.test[distance < 0.44].any()
    far = distance > 0.46
    assert (narrowed.test == split.test)[far].all() and (narrowed.train == split.train)[far].all()


def test_a_gap_of_training_rows_is_probed_in_its_middle() -> None:
    time, split = whole(400.0)
    begins = time[1:][np.diff(split.test.astype(int)) == 1][3]
    first, last = begins - 0.5, begins + 5.4
    for moment in (first - 0.1, first + 1.0, last + 0.1):
        assert probe(split, time, moment) == pytest.approx(0.5 * (first + last), abs=0.11)
    assert probe(split, time, first - 0.5) is None and probe(split, time, last + 0.5) is None


# --- the remainder's noise ------------------------------------------------------------------------------


def test_a_value_is_drawn_inside_the_step_that_it_was_rounded_to() -> None:
    true = 100.0 + 3.0 * np.random.default_rng(3).normal(size=(2000, 3))
    rounded = 10.0 * np.round(true / 10.0)
    drawn = identification._before_rounding(rounded, np.full_like(true, 100.0), np.full(3, 3.0), 10.0)
    assert np.abs(drawn - rounded).max() <= 5.0
    # If the model is true, what is drawn is what was there before.
    assert drawn.mean() == pytest.approx(100.0, abs=0.15) and drawn.std() == pytest.approx(3.0, rel=0.04)
    assert ((drawn - 100.0) ** 4).mean() == pytest.approx(3.0 * 81.0, rel=0.15)
    far = identification._before_rounding(
        np.full((1, 3), 200.0), np.full((1, 3), 100.0), np.full(3, 3.0), 10.0
    )
    assert far.tolist() == [[195.0] * 3]


def test_the_steps_own_noise_is_added_to_the_floors() -> None:
    quiet = white(np.array([1.0, 2.0, 3.0]))
    noisy = identification.with_white({"mag": quiet}, 3.0)["mag"]
    assert noisy.rms == pytest.approx(np.sqrt(np.array([1.0, 4.0, 9.0]) + 3.0))
    assert noisy.sigma == pytest.approx(np.sqrt(quiet.sigma**2 + 3.0)) and math.isfinite(
        float(noisy.sigma[0])
    )
