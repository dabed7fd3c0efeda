"""A yaw that nothing but the compass tells may wander for minutes, and swallows no turn of the vehicle."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mavcompass.gap.attitude.navigation import wandering_yaw
from mavcompass.gap.attitude.reference import Reference


def reference(witnessed: bool) -> Reference:
    n = 300
    still, known = np.tile(np.eye(3), (n, 1, 1)), np.ones(n, dtype=np.bool_)
    own = np.zeros((n, 3, 2))
    own[:, :2, 0] = 0.01
    return Reference("fused", still, np.zeros((n, 3)), known, curves_rad=own, witnessed=witnessed)


@pytest.mark.parametrize("span_s", [40.0, 200.0, 1_200.0])
def test_it_is_off_by_twenty_degrees_at_any_time_and_about_the_vertical_alone(span_s: float) -> None:
    curves = wandering_yaw(np.linspace(5.0, 5.0 + span_s, 500))
    sigma = np.degrees(np.sqrt(np.sum(curves[:, 2] ** 2, axis=1)))
    assert not curves[:, :2].any()
    assert sigma == pytest.approx(20.0, abs=1.5)
    assert curves.shape[2] <= 31


@pytest.mark.parametrize(("period_s", "share"), [(150.0, 0.95), (20.0, 0.1)])
def test_what_takes_minutes_is_followed_and_what_goes_with_a_turn_is_not(
    period_s: float, share: float
) -> None:
    time_s = np.linspace(0.0, 300.0, 900)
    off = math.radians(10.0) * np.sin(2.0 * np.pi * time_s / period_s)
    curves, sigma = wandering_yaw(time_s)[:, 2], math.radians(2.0)
    columns = np.vstack([curves / sigma, np.eye(curves.shape[1])])
    told = np.concatenate([off / sigma, np.zeros(curves.shape[1])])
    followed = curves @ np.linalg.lstsq(columns, told, rcond=None)[0]
    explained = 1.0 - float(np.sum((off - followed) ** 2) / np.sum(off**2))
    assert explained > share if period_s > 100.0 else explained < share


def test_only_a_yaw_without_a_witness_wanders() -> None:
    time_s = np.linspace(0.0, 60.0, 300)
    assert reference(True).alone(time_s).curves_rad.shape[2] == 2
    doubted = reference(False).alone(time_s)
    assert doubted.curves_rad.shape[2] > 4
    # Rolling curves turn no yaw.
    amplitudes = np.zeros(doubted.curves_rad.shape[2])
    amplitudes[0] = 3.0
    assert not doubted.wander_rad(amplitudes).any()
    amplitudes[2] = 1.0
    assert doubted.wander_rad(amplitudes) == pytest.approx(doubted.curves_rad[:, 2, 2])


def test_without_a_baseline_small_curves_are_part_of_the_rest() -> None:
    rng, n = np.random.default_rng(4), 40
    curves = rng.normal(size=(n, 3, 70)) * np.linspace(0.02, 0.001, 70)
    still, known = np.tile(np.eye(3), (n, 1, 1)), np.ones(n, dtype=np.bool_)
    whole = Reference("fused", still, np.zeros((n, 3)), known, curves_rad=curves, rest_rad2=1e-4 * np.eye(3))
    alone = whole.alone(np.linspace(0.0, 8.0, n))
    assert np.array_equal(alone.curves_rad, curves[:, :, :48])
    told = [np.einsum("nik,njk->ij", r.curves_rad, r.curves_rad) / n + r.rest_rad2 for r in (whole, alone)]
    np.testing.assert_allclose(told[1], told[0])
