"""Held-out blocks, and changes that take time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavcompass.gap import diagnose_gap
from mavcompass.gap.selection.split import probe, split_blocks, with_windows
from mavcompass.gap.trial.cases import Recipe, make_track
from mavcompass.simulation import effects
from mavcompass.track import Series


@settings(max_examples=30, deadline=None)
@given(st.floats(20.0, 400.0), st.floats(5.0, 50.0))
def test_training_and_held_out_rows_never_touch(duration_s: float, rate_hz: float) -> None:
    t = np.arange(0.0, duration_s, 1.0 / rate_hz)
    split = split_blocks(t, np.ones(t.size, dtype=bool))
    assert not (split.train & split.test).any()
    guard = min(0.5, duration_s / 60.0) * 0.9
    distance = np.abs(t[split.train][:, None] - t[split.test][None, :: max(1, t.size // 200)])
    assert distance.min() > guard - 1.0 / rate_hz
    assert 0.1 < split.test.mean() < 0.4, "one of every four"


def test_narrow_window_brings_a_change_between_training_rows() -> None:
    t = np.arange(0.0, 100.0, 0.05)
    valid = np.ones(t.size, dtype=bool)
    split = split_blocks(t, valid)
    moment = float(t[split.test][len(t[split.test]) // 2]) + 0.7
    narrowed = split
    for _ in range(6):
        middle = probe(narrowed, t, moment)
        if middle is None:
            break
        narrowed = with_windows(narrowed, t, valid, [middle])
    assert probe(narrowed, t, moment) is None and not (narrowed.train & narrowed.test).any()
    assert narrowed.test.sum() > 0.8 * split.test.sum()


def test_step_by_hand_keeps_its_size() -> None:
    """While a hand brings a magnet near, the field swings: what it does then is no part of the step."""
    fault = [effects.parse("hard_iron_step:x=60,y=-40,z=90,on_s=31.3")]
    track = make_track(Recipe("rich", duration_s=60.0, rate_hz=10.0, seed=31), fault)
    series, lasts_s = track.compasses[1].reported, 1.2
    since = series.time_s - 31.3
    swing = np.where((since > 0.0) & (since < lasts_s), 150.0 * np.sin(4.0 * since), 0.0)
    moved = Series.of(series.time_s, series.values + swing[:, None] * np.array([1.0, 0.5, -0.7]))
    bent = replace(track, compasses={1: replace(track.compasses[1], reported=moved)})
    found = diagnose_gap(bent)
    step = next(c for c in found.causes if c.effect == "hard_iron_step")
    for name, true in (("x", 60.0), ("y", -40.0), ("z", 90.0)):
        assert step.parameters[name] == pytest.approx(true, abs=2.0)
    assert step.parameters["on_s"] == pytest.approx(31.3, abs=0.1 + lasts_s)
