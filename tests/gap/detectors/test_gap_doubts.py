"""How far what single readings tell may be off, against closed forms and by chance."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mavcompass.frames import FloatArray
from mavcompass.gap.detectors.detect import estimated_step, stale_sigma
from mavcompass.gap.detectors.rapid import burst_mgauss, excess_variance, find_rapid
from mavcompass.gap.replay.integrity import Readings

B, NOISE = np.array([6.0, -9.0, 4.0]), 2.0
T = np.arange(0.0, 100.0, 0.05)


def line(seed: int, hertz: float) -> tuple[Readings, dict[str, float]]:
    """Return readings with a line in white noise, and its values."""
    rng = np.random.default_rng(seed)
    phase = 2.0 * np.pi * hertz * T
    waves = np.outer(np.sin(phase), B) + np.outer(np.cos(phase), B[::-1])
    nominal = np.tile([200.0, 0.0, 400.0], (T.size, 1))
    turning = nominal + 50.0 * np.sin(0.3 * T)[:, None]
    error = waves + NOISE * rng.standard_normal(waves.shape)
    true = dict(zip(("sin_x", "sin_y", "sin_z", "cos_x", "cos_y", "cos_z"), [*B, *B[::-1]], strict=True))
    return Readings.of(T, turning + error, turning, np.ones(T.size, dtype=np.bool_)), true


def test_frequency_of_a_line_is_told_as_well_as_it_can_be() -> None:
    found = find_rapid(line(1, 3.3)[0], None, 1.0)
    assert found is not None
    amplitude2 = 2.0 * float(B @ B)
    least = math.sqrt(24.0 * NOISE**2 / (amplitude2 * T.size)) / (2.0 * math.pi * T[-1])
    assert found.sigma["frequency_hz"] == pytest.approx(least, rel=0.1)


def test_intervals_of_a_line_hold_it() -> None:
    hits = total = 0
    for seed in range(60):
        readings, true = line(seed, 3.3)
        found = find_rapid(readings, None, 1.0)
        assert found is not None
        for name, value in {**true, "frequency_hz": 3.3}.items():
            hits += int(abs(found.parameters[name] - value) < 1.96 * found.sigma[name])
            total += 1
    assert 0.92 < hits / total < 0.985


def _coarse(step: float, told: float, seed: int) -> Any:
    rng = np.random.default_rng(seed)
    yaw = np.cumsum(0.02 * rng.standard_normal(2000))
    field = 400.0 * np.stack([np.cos(yaw), np.sin(yaw), 0.0 * yaw + 1.0], axis=1)
    raw = np.round(step * np.round((field + rng.standard_normal(field.shape)) / step))
    readings = SimpleNamespace(
        error_mgauss=raw - field, nominal_mgauss=field, valid=np.ones(len(raw), dtype=np.bool_)
    )
    return SimpleNamespace(trace=SimpleNamespace(step_mgauss=told), readings=readings)


@pytest.mark.parametrize("step", [6.4, 10.0, 21.676])
def test_step_is_told_by_how_many_of_them_readings_are(step: float) -> None:
    for seed in range(5):
        found, sigma = estimated_step(_coarse(step, step * 1.0003, seed))
        assert found == pytest.approx(step, abs=max(4.0 * sigma, 1e-9))
        assert sigma < 1e-3 * step


def test_share_of_repeats_scatters_as_chance_has_it() -> None:
    rng = np.random.default_rng(3)
    for share in (0.05, 0.4):
        stale = rng.random((400, 600)) < share
        replay: Any = SimpleNamespace(trace=SimpleNamespace(fresh_s=np.zeros(round(600 * (1.0 - share)))))
        assert float(stale.mean(axis=1).std()) == pytest.approx(stale_sigma(replay, share), rel=0.15)
    assert stale_sigma(replay, 0.0) == 0.0


def scattered(seed: int, bursts_mgauss: float, turns: bool = False, late_s: float = 0.0) -> Readings:
    """Return readings with noise, that scatter far more for a second of every ten."""
    rng = np.random.default_rng(seed)
    nominal = np.tile([200.0, 0.0, 400.0], (T.size, 1))
    if turns:
        # A quarter turn in half a second, every eight.
        yaw = 0.5 * np.pi * np.clip(T % 8.0 / 0.5, 0.0, 1.0) + 0.5 * np.pi * (T // 8.0)
        earlier = np.interp(T - late_s, T, yaw)
        nominal = 200.0 * np.stack([np.cos(yaw), -np.sin(yaw), 2.0 + 0.0 * yaw], axis=1)
        seen = 200.0 * np.stack([np.cos(earlier), -np.sin(earlier), 2.0 + 0.0 * yaw], axis=1)
    else:
        seen = nominal
    loud = bursts_mgauss * (T % 10.0 < 1.0)[:, None] * rng.standard_normal(nominal.shape)
    raw = seen + NOISE * rng.standard_normal(nominal.shape) + loud
    return Readings.of(T, raw, nominal, np.ones(T.size, dtype=np.bool_))


def test_bursts_of_single_readings_are_told_by_how_they_stand_off_their_neighbours() -> None:
    healthy = scattered(1, 0.0)
    assert burst_mgauss(scattered(2, 0.0), healthy) == 0.0
    # A tenth of the readings scatters by 40 mG.
    assert burst_mgauss(scattered(3, 40.0), healthy) == pytest.approx(40.0 * math.sqrt(0.1), rel=0.25)
    assert burst_mgauss(scattered(3, 40.0), scattered(4, 40.0)) == 0.0


def test_scatter_that_comes_and_goes_need_not_stand_far_off() -> None:
    """Blades that pass add a few sigmas to a tenth of the readings: none of them stands out by itself."""
    healthy = scattered(1, 0.0)
    louder = scattered(3, 4.0 * NOISE)
    assert burst_mgauss(louder, healthy) == pytest.approx(4.0 * NOISE * math.sqrt(0.1), rel=0.25)
    # A variance that is not doubled may be another day's noise.
    assert burst_mgauss(scattered(3, 2.5 * NOISE), healthy) == 0.0
    # A vehicle that swings makes its late readings scatter, for a part of the time.
    assert burst_mgauss(scattered(2, 0.0, turns=True, late_s=0.1), healthy) == 0.0


@pytest.mark.parametrize("seed", range(5))
def test_late_readings_of_a_vehicle_that_turns_now_and_then_are_no_bursts(seed: int) -> None:
    healthy = scattered(1, 0.0)
    assert burst_mgauss(scattered(seed, 0.0, turns=True, late_s=0.1), healthy) == 0.0


@pytest.mark.parametrize("field", [(200.0, 0.0, 400.0), (150.0, -250.0, 300.0)])
def test_an_attitude_that_shakes_leaves_no_scatter_along_the_field(field: tuple[float, ...]) -> None:
    """A rover rocks faster than its gyro is read: its compass scatters on each axis, as if it were noise."""
    rng = np.random.default_rng(9)
    nominal = np.tile(field, (T.size, 1))

    def beside(error: FloatArray) -> Readings:
        raw = nominal + NOISE * rng.standard_normal(nominal.shape) + error
        return Readings.of(T, raw, nominal, np.ones(T.size, dtype=np.bool_))

    healthy, size = beside(np.zeros_like(nominal)), math.radians(1.0)
    shaken = beside(np.cross(nominal, size * rng.standard_normal(nominal.shape)))
    assert burst_mgauss(shaken, healthy) == 0.0 and excess_variance(shaken, healthy) == 0.0
    sigma = size * float(np.linalg.norm(field))
    noisy = beside(sigma * rng.standard_normal(nominal.shape))
    assert burst_mgauss(noisy, healthy) == pytest.approx(sigma, rel=0.1)
    assert excess_variance(noisy, healthy) == pytest.approx(sigma**2, rel=0.15)
