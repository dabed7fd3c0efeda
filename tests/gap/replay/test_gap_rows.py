"""Readings that are averaged to rows: how many are enough, and when a mean is a reading of its middle."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from mavcompass.errors import BadRecording
from mavcompass.frames import (
    FloatArray,
    euler_to_matrix,
    euler_to_quaternion,
    matrix_to_euler,
    rotate_back,
)
from mavcompass.gap.attitude.kinematics import averaged
from mavcompass.gap.attitude.reference import Reference, body_rate
from mavcompass.gap.fit.model import Problem
from mavcompass.gap.replay.noise import white
from mavcompass.gap.replay.nominal import replay
from mavcompass.gap.replay.nuisance import of_telemetry
from mavcompass.gap.replay.rows import compass_rows, middles, shared_period_s, swing, unbroken
from mavcompass.gap.residual.baseline import prior_of
from mavcompass.gap.residual.floor import STATED
from mavcompass.gap.tables import usual
from mavcompass.gap.trial.vehicles import make_case
from mavcompass.track import MagSeries, Series, Track

T = np.arange(0.0, 60.0, 0.1)
FIELD = np.array([220.0, 30.0, 430.0])
TURNED = np.array([[0.0, 1.1, 0.05], [-0.9, 0.0, 0.0], [0.02, 0.1, 1.0]])
OFFSET = np.array([300.0, -150.0, 80.0])


def attitude(t: FloatArray) -> FloatArray:
    """Turn, stop, turn back, and swing meanwhile."""
    yaw = 0.9 * np.tanh(2.0 * np.sin(0.35 * t)) + 0.4 * np.sin(1.1 * t)
    return euler_to_matrix(0.15 * np.sin(1.7 * t), 0.1 * np.sin(1.3 * t), yaw)


def seen(t: FloatArray) -> FloatArray:
    return rotate_back(attitude(t), np.tile(FIELD, (t.size, 1)))


def slopes(t: FloatArray) -> FloatArray:
    return np.cross(seen(t), body_rate(t, attitude(t)))


def recorded(count: int, step_s: float, reference: bool = False) -> Track:
    t = step_s * np.arange(count)
    attitudes = Series.of(t, np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))) if reference else None
    return Track(compasses={1: MagSeries(1, Series.of(t, seen(t)))}, reference_q=attitudes)


@pytest.mark.parametrize("late_s", [0.0, 0.06, 0.14])
@pytest.mark.parametrize("width", [3, 5])
@pytest.mark.parametrize(("matrix", "offset"), [(np.eye(3), 0.0 * OFFSET), (TURNED, OFFSET)])
def test_a_mean_with_its_swing_is_a_reading_of_its_middle(
    late_s: float, width: int, matrix: FloatArray, offset: FloatArray
) -> None:
    """However the compass is mounted, and however late it is."""
    raw = seen(T - late_s) @ matrix.T + offset
    swings, told_s = swing(T, raw, seen(T), slopes(T), np.ones(T.size, dtype=np.bool_), width)
    picked = middles(T.size, width)
    mean = averaged(raw, width)
    inner = slice(10, -10)
    off = np.abs(mean + swings - raw)[picked][inner]
    assert float(np.sqrt(np.mean(off**2))) < 0.06 * float(np.sqrt(np.mean((mean - raw)[picked][inner] ** 2)))
    assert told_s == pytest.approx(late_s, abs=0.011)


@pytest.mark.parametrize("step_s", [0.1, 0.025, 0.01])
def test_means_of_gyro_and_accelerometer_are_readings_of_a_rows_middle_however_often_they_come(
    step_s: float,
) -> None:
    t = np.arange(0.0, 60.0, step_s)
    rotation = attitude(t)
    felt = rotate_back(rotation, np.tile([0.0, 0.0, -9.80665], (t.size, 1)))
    track = Track(
        compasses={1: MagSeries(1, Series.of(T, seen(T)))},
        gyro_radps=Series.of(t, body_rate(t, rotation)),
        acc_mps2=Series.of(t, felt),
        reference_q=Series.of(t, np.array([euler_to_quaternion(*matrix_to_euler(r)) for r in rotation])),
    )
    rows = replay(track, period_s=0.3)
    assert rows.averaged == 3
    inner, nominal = slice(3, -3), rows.signals.reading
    turning = nominal.gyro_radps[inner].std()
    assert (rows.measured.gyro_radps - nominal.gyro_radps)[inner].std() < 0.005 * turning
    assert (rows.measured.acc_mps2 - nominal.acc_mps2)[inner].std() < 0.005


@pytest.mark.parametrize("width", [3, 5])
def test_a_mean_over_a_silence_is_left_out(width: int) -> None:
    t = np.delete(T, np.arange(200, 210))
    whole = unbroken(t, width)
    spans = np.ptp(t[: t.size // width * width].reshape(-1, width), axis=1)
    assert whole.size == spans.size and np.array_equal(whole, spans < 0.1 * width)
    assert (~whole).sum() == (200 % width > 0)
    assert unbroken(T, width).all()


def test_how_late_is_what_is_usual_where_nothing_swings() -> None:
    still = np.tile([200.0, 10.0, 400.0], (T.size, 1))
    raw = still + np.random.default_rng(3).standard_normal(still.shape)
    swings, late_s = swing(T, raw, still, 0.0 * still, np.ones(T.size, dtype=np.bool_), 3)
    assert np.abs(swings).max() < 1e-6 and late_s == pytest.approx(0.06)


def test_a_reference_is_known_as_it_was_before_but_not_through_a_silence() -> None:
    t = np.concatenate([T[:300], T[300:] + 5.0])
    rotation = attitude(t)
    reference = Reference("fused", rotation, body_rate(t, rotation), np.ones(t.size, dtype=np.bool_))
    earlier = reference.earlier(t, 0.08)
    off = np.abs(earlier.rotation - attitude(t - 0.08)).max(axis=(1, 2))
    # The two rates beside the silence, and at the ends, are not known either.
    beside = np.r_[0:3, 297:303, t.size - 3 : t.size]
    assert np.delete(off, beside).max() < 2e-3
    assert off[300] < 0.05


@pytest.mark.parametrize(
    ("counts", "step_s", "period_s"),
    [
        ([700], 0.1, 0.0),  # few enough
        ([1000], 0.1, 0.125),  # half of them are enough
        ([1000, 800], 0.1, 0.125),
        ([1000, 700], 0.1, 0.0),  # of which the shorter one would keep too few
        ([1900, 600], 0.1, 0.119),  # but no more than so many in any case
        ([4800], 0.1, 0.3),  # and nothing slower than loads change, while there is room
        ([9600], 0.1, 0.6),
    ],
)
def test_rows_are_as_few_as_each_recording_can_spare(
    counts: list[int], step_s: float, period_s: float
) -> None:
    tracks = [recorded(count, step_s) for count in counts]
    assert shared_period_s(tracks, 1) == pytest.approx(period_s, rel=0.01, abs=1e-9)


def test_a_laboratorys_readings_are_kept() -> None:
    assert shared_period_s([recorded(2900, 0.02, reference=True)], 1) == 0.0


def test_rows_of_a_flight_are_earlier_than_their_readings_by_how_late_these_are() -> None:
    """What moves or is switched does so when the field is measured, not when its reading comes."""
    case = make_case(23, "none")
    assert case.baseline is not None
    replayed = replay(case.track, period_s=0.3)
    assert replayed.averaged > 1 and replayed.late_s > 0.0
    rows = compass_rows(case.track, case.track.compasses[1], 0.3)
    came = rows.time_s[middles(rows.time_s.size, rows.width)]
    np.testing.assert_allclose(came - replayed.time_s, replayed.late_s, atol=1e-9)
    assert replay(case.track, period_s=0.0).late_s == 0.0
    assert replay(case.track, period_s=0.3, most_averaged=1).averaged == 1


def test_what_a_flight_leaves_is_the_same_whenever_its_rows_are_taken() -> None:
    """Readings are as late as they are: between rows far apart the vehicle turns as its attitude tells."""
    track = make_case(5, "none", baseline=False).track
    left = []
    for late_s in (0.0, 0.05, 0.1):
        replayed = replay(track, period_s=0.3, late_s=late_s)
        prior = prior_of(replayed, STATED)
        problem = Problem(replayed, {"mag": white(np.full(3, 3.0))}, replayed.valid, prior)
        left.append(problem.null().sse)
    assert replayed.averaged > 1
    assert max(left) < 1.02 * min(left)


def test_too_few_readings_name_the_compass_that_has_more() -> None:
    few, many = (Series.of(t, seen(t)) for t in (T[:40], T))
    track = Track(compasses={1: MagSeries(1, few), 2: MagSeries(2, many)})
    with pytest.raises(BadRecording, match="40 readings of compass 1") as caught:
        compass_rows(track, track.compasses[1])
    assert "Compass 2 has 600: choose it with --compass 2" in caught.value.remedy
    alone: Any = Track(compasses={1: MagSeries(1, few)})
    with pytest.raises(BadRecording) as caught:
        compass_rows(alone, alone.compasses[1])
    assert "half a minute" in caught.value.remedy


@pytest.mark.parametrize("step_s", [0.1, 0.04])
def test_an_autopilots_means_are_a_low_pass_that_is_as_wide_and_no_wider_than_its_reading_allows(
    step_s: float,
) -> None:
    age, mean = of_telemetry(0.02, step_s)
    (smoothing,) = mean.effects
    assert age.mean[0] == pytest.approx(usual.age.usual_s - 0.02)
    # Readings of all the time between two differ in their times by as much as those of a low pass.
    over = np.linspace(0.0, step_s, 10_001)
    assert smoothing.upper[0] == pytest.approx(over.std(), rel=1e-3)
    assert 0.0 == smoothing.lower[0] < mean.mean[0] < smoothing.upper[0]
