"""Sphere and ellipsoid: exact where readings are, as sure as theory says, and unmoved by a few wild ones."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mavcompass.calibration.methods.ellipsoid import (
    _algebraic_sphere,
    fit_ellipsoid,
    fit_sphere,
    sphere_coverage,
)
from mavcompass.errors import PoorCalibration
from mavcompass.frames import FloatArray

CENTRE = np.array([120.0, -80.0, 40.0])
SHAPE = np.array([[1.1, 0.05, -0.03], [0.05, 0.9, 0.04], [-0.03, 0.04, 1.0]])  # its diagonal averages 1


def all_round(count: int = 400) -> FloatArray:
    """Directions (N, 3) spread evenly over the sphere."""
    k = np.arange(float(count)) + 0.5
    height, angle = 1.0 - 2.0 * k / count, math.pi * (1.0 + math.sqrt(5.0)) * k
    across = np.sqrt(1.0 - height**2)
    return np.stack([across * np.cos(angle), across * np.sin(angle), height], axis=1)


def bent(count: int = 400, length: float = 500.0) -> FloatArray:
    return CENTRE + length * all_round(count) @ np.linalg.inv(SHAPE)


def noisy(readings: FloatArray, sigma: float, seed: int = 1) -> FloatArray:
    return readings + sigma * np.random.default_rng(seed).normal(size=readings.shape)


def test_a_sphere_is_found_exactly() -> None:
    fit = fit_sphere(CENTRE + 500.0 * all_round())
    assert fit.centre_mgauss == pytest.approx(CENTRE) and fit.length_mgauss == pytest.approx(500.0)
    assert fit.matrix.tolist() == np.eye(3).tolist() and fit.coverage == 1.0
    assert fit.residual_rms_mgauss == pytest.approx(0.0, abs=1e-6)


def test_an_ellipsoid_is_found_exactly() -> None:
    fit = fit_ellipsoid(bent())
    assert fit.centre_mgauss == pytest.approx(CENTRE) and fit.length_mgauss == pytest.approx(500.0)
    assert fit.matrix == pytest.approx(SHAPE) and fit.coverage == 1.0
    known = fit_ellipsoid(bent(), 250.0)  # a world that is half as strong: the compass reads double
    assert known.matrix == pytest.approx(0.5 * SHAPE) and known.length_mgauss == 250.0


def test_noise_leaves_what_theory_says() -> None:
    fit = fit_sphere(noisy(CENTRE + 500.0 * all_round(), 4.0))
    # N even directions: 3 s^2 / N of each axis.
    assert np.sqrt(np.diag(fit.covariance)) == pytest.approx([4.0 * math.sqrt(3.0 / 400.0)] * 3, rel=0.08)
    assert fit.residual_rms_mgauss == pytest.approx(4.0, rel=0.06)
    assert fit.residual_rms_mgauss / fit.length_mgauss == pytest.approx(4.0 / 500.0, rel=0.06)
    assert fit.centre_mgauss == pytest.approx(CENTRE, abs=1.2)


def test_an_ellipsoids_sigma_is_the_scatter_of_its_fits() -> None:
    fits = [fit_ellipsoid(noisy(bent(90), 4.0, seed), 500.0) for seed in range(40)]
    found = np.array([[*f.centre_mgauss, *f.matrix[np.triu_indices(3)]] for f in fits])
    claimed = np.sqrt(np.mean([np.diag(f.covariance) for f in fits], axis=0))[[0, 1, 2, 3, 6, 7, 4, 8, 5]]
    assert found.std(axis=0) / claimed == pytest.approx(np.ones(9), abs=0.35)
    assert (found.std(axis=0) / claimed).mean() == pytest.approx(1.0, abs=0.12)


def test_without_a_length_the_covariance_is_of_the_scaled_matrix() -> None:
    known, unknown = fit_ellipsoid(noisy(bent(), 4.0), 250.0), fit_ellipsoid(noisy(bent(), 4.0))
    factor = unknown.matrix[0, 0] / known.matrix[0, 0]
    assert np.trace(unknown.matrix) == pytest.approx(3.0) and factor == pytest.approx(2.0, rel=0.01)
    scale = np.array([1.0] * 3 + [factor] * 6)
    assert unknown.covariance == pytest.approx(known.covariance * np.outer(scale, scale), rel=1e-4, abs=1e-12)
    assert unknown.residual_rms_mgauss == pytest.approx(factor * known.residual_rms_mgauss, rel=1e-4)
    scale = unknown.length_mgauss / known.length_mgauss
    assert unknown.residual_rms_mgauss == pytest.approx(scale * known.residual_rms_mgauss, rel=1e-4)


def test_a_few_wild_readings_hardly_move_it() -> None:
    readings = noisy(CENTRE + 500.0 * all_round(), 1.0)
    readings[:8] += 150.0
    assert fit_sphere(readings).centre_mgauss == pytest.approx(CENTRE, abs=0.5)
    twisted = noisy(bent(), 1.0)
    twisted[:8] += 150.0
    assert fit_ellipsoid(twisted).centre_mgauss == pytest.approx(CENTRE, abs=0.5)


@pytest.mark.parametrize(("fit", "fewest"), [(fit_sphere, 12), (fit_ellipsoid, 27)])
def test_three_readings_for_each_quantity_are_enough(fit: object, fewest: int) -> None:
    assert callable(fit)
    readings = CENTRE + 500.0 * all_round(fewest)
    assert fit(readings).length_mgauss == pytest.approx(500.0)
    with pytest.raises(
        PoorCalibration, match=f"{fewest - 1} readings are too few to fit {fewest // 3} quant"
    ):
        fit(np.vstack([readings[1:], np.full(3, np.nan)]))


@pytest.mark.parametrize("fit", [fit_sphere, fit_ellipsoid])
def test_what_lies_in_a_plane_is_refused(fit: object) -> None:
    assert callable(fit)
    circle = np.linspace(0.0, 6.2, 100)
    flat = np.stack([200.0 * np.cos(circle), -200.0 * np.sin(circle), np.full(100, 400.0)], axis=1)
    for readings in (flat, flat[:, [2, 0, 1]], np.tile(CENTRE, (100, 1)), flat * [1.0, 0.0, 1.0]):
        with pytest.raises(PoorCalibration, match="lie in a plane or on a line"):
            fit(readings)


def test_a_saddle_is_no_ellipsoid() -> None:
    x, y = (a.ravel() for a in np.meshgrid(np.linspace(-2.0, 2.0, 9), np.linspace(-2.0, 2.0, 9)))
    z = np.sqrt(np.maximum(1.0 + x**2 - 0.5 * y**2, 0.0)) * np.where(np.arange(81) % 2, 1.0, -1.0)
    with pytest.raises(PoorCalibration):
        fit_ellipsoid(100.0 * np.stack([x, y, z], axis=1))


def test_coverage_is_the_share_of_the_sphere_that_is_pointed_to() -> None:
    ways = all_round(4000)
    assert sphere_coverage(ways) == 1.0
    caps = [sphere_coverage(ways[sign * ways[:, axis] > 0.6]) for axis in range(3) for sign in (1.0, -1.0)]
    assert caps == pytest.approx([0.275] * 6, abs=0.05)  # a fifth, and the patches that it cuts
    assert sphere_coverage(7.0 * ways[:1]) == sphere_coverage(np.tile(ways[:1], (50, 1))) == 1.0 / 80.0
    # Every direction of a patch is nearest to its own middle.
    assert sphere_coverage(all_round(80)) == 1.0 and sphere_coverage(all_round(80)[:20]) == 0.25
    assert sphere_coverage(np.tile(ways, (16, 1))) == 1.0  # of very many, some are looked at


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
def test_a_lengths_unit_does_not_matter(size: float) -> None:
    readings = noisy(bent(120), 3.0)
    one, other = fit_ellipsoid(readings), fit_ellipsoid(size * readings)
    assert other.centre_mgauss == pytest.approx(size * one.centre_mgauss, rel=1e-6)
    assert other.matrix == pytest.approx(one.matrix, rel=1e-6)
    assert other.length_mgauss == pytest.approx(size * one.length_mgauss, rel=1e-6)
    ball = noisy(CENTRE + 500.0 * all_round(), 3.0)
    round_one, round_other = fit_sphere(ball), fit_sphere(size * ball)
    assert round_other.centre_mgauss == pytest.approx(size * round_one.centre_mgauss, rel=1e-6)
    assert round_other.covariance == pytest.approx(
        size**2 * round_one.covariance, rel=1e-5, abs=1e-12 * size**2
    )


def test_a_sphere_far_from_its_own_middle_is_found() -> None:
    """A cap: the mean of the readings is far from the centre, and the first answer is exact all the same."""
    ways = all_round(4000)
    cap = np.array([1000.0, -2000.0, 500.0]) + 300.0 * ways[ways[:, 0] > 0.3]
    fit = fit_sphere(cap)
    assert fit.centre_mgauss == pytest.approx(
        [1000.0, -2000.0, 500.0]
    ) and fit.length_mgauss == pytest.approx(300.0)
    centre, radius = _algebraic_sphere(cap)
    assert centre == pytest.approx([1000.0, -2000.0, 500.0]) and radius == pytest.approx(300.0)
