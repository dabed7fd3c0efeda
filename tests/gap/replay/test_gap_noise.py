"""The noise of a sensor that also carries an error which wanders for seconds."""

from __future__ import annotations

import numpy as np
import pytest
import scipy

from mavcompass.frames import FloatArray
from mavcompass.gap.replay.noise import SensorNoise, estimate_noise, recursive, rough_sigma, white


def wandering(seed: int, n: int = 3000, share: float = 0.45, memory: float = 60.0) -> FloatArray:
    """Make white scatter of 1 on an error of `share` that lasts for `memory` readings, (n, 3)."""
    rng = np.random.default_rng(seed)
    rho = 1.0 - 1.0 / memory
    slow = scipy.signal.lfilter(
        [np.sqrt(1.0 - rho**2)], [1.0, -rho], rng.standard_normal((n + 500, 3)), axis=0
    )[500:]
    return np.asarray(share * slow + rng.standard_normal((n, 3)))


def slow_gain(noise: SensorNoise, error: FloatArray) -> float:
    """Return what a constant and a slow sine gain in twice the log likelihood, three axes together."""
    phase = np.linspace(0.0, 6.0 * np.pi, len(error))
    columns = np.stack([np.ones_like(phase), np.sin(phase), np.cos(phase)], axis=1)
    white, target = noise.decorrelated(columns[:, None])[:, 0], noise.whiten(error)
    left = target - white @ np.linalg.lstsq(white, target, rcond=None)[0]
    return float(np.sum(target**2) - np.sum(left**2))


@pytest.mark.parametrize("count", [1, 31, 32, 33, 1000])
def test_recursion_is_that_of_a_filter_for_each_channel_whatever_the_length(count: int) -> None:
    columns = np.random.default_rng(count).standard_normal((count, 4, 2))
    factors = np.array([0.0, 0.6, -0.4, 0.999])
    found = recursive(factors, columns)
    for channel, factor in enumerate(factors):
        wanted = scipy.signal.lfilter([1.0], [1.0, -factor], columns[:, channel], axis=0)
        np.testing.assert_allclose(found[:, channel], wanted, atol=1e-11)


def test_slow_error_under_scatter_is_no_cause() -> None:
    noise = estimate_noise(wandering(1), np.ones(3000, dtype=bool), 0.0)
    assert (noise.moving > 0.0).all() and 0.9 < noise.coefficients[0, 0] < 1.0
    # Nine free parameters of nothing gain nine on the average, on other recordings of the same error too.
    gains = [slow_gain(noise, wandering(seed)) for seed in range(2, 22)]
    assert 4.0 < np.mean(gains) < 20.0


def test_rows_without_a_reading_do_not_hide_the_slow_error() -> None:
    error, usable = wandering(4), np.random.default_rng(5).random(3000) > 0.02
    error[~usable] = 0.0
    noise = estimate_noise(error, usable, 0.0)
    assert (noise.moving > 0.0).all() and 0.9 < noise.coefficients[0, 0] < 1.0


def test_correlated_noise_is_estimated_and_whitened() -> None:
    rng = np.random.default_rng(1)
    white_noise = rng.standard_normal((20_000, 3))
    error = np.empty_like(white_noise)
    error[0] = white_noise[0]
    for i in range(1, len(error)):
        error[i] = 0.6 * error[i - 1] + 2.0 * white_noise[i]
    noise = estimate_noise(error, np.ones(len(error), dtype=bool), 0.0)
    np.testing.assert_allclose(noise.coefficients[0], 0.6, atol=0.02)
    assert not noise.moving.any()
    np.testing.assert_allclose(noise.sigma, 2.0, rtol=0.02)
    z = noise.whiten(error)[1:]
    assert abs(np.mean(z[1:] * z[:-1])) < 0.02 and abs(z.std() - 1.0) < 0.02


def test_scatter_is_seen_behind_a_slow_cause() -> None:
    rng = np.random.default_rng(2)
    t = np.arange(4000) * 0.05
    error = 50.0 * np.sin(0.3 * t)[:, None] + 2.0 * rng.standard_normal((4000, 3))
    np.testing.assert_allclose(rough_sigma(error, np.ones(4000, dtype=bool)), 2.0, rtol=0.1)
    assert white(np.full(3, 2.0)).whiten(error).std() > 10.0
