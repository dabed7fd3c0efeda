"""How far what single readings tell may be off, against closed forms and by chance."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mavcompass.gap.replay import Readings
from mavcompass.gap.traces.rapid import find_rapid
from mavcompass.gap.traces.steps_and_repeats import stale_doubt, told_step

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
        found, sigma = told_step(_coarse(step, step * 1.0003, seed))
        assert found == pytest.approx(step, abs=max(4.0 * sigma, 1e-9))
        assert sigma < 1e-3 * step


def test_share_of_repeats_scatters_as_chance_has_it() -> None:
    rng = np.random.default_rng(3)
    for share in (0.05, 0.4):
        stale = rng.random((400, 600)) < share
        replay: Any = SimpleNamespace(trace=SimpleNamespace(fresh_s=np.zeros(round(600 * (1.0 - share)))))
        assert float(stale.mean(axis=1).std()) == pytest.approx(stale_doubt(replay, share), rel=0.15)
    assert stale_doubt(replay, 0.0) == 0.0
