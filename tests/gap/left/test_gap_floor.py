"""What a floor is made of: errors of headings beside errors of the field."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mavcompass.frames import FloatArray
from mavcompass.gap.left.floor import heading_error_rad, heading_scatter, measured_noise, rms
from mavcompass.gap.replay.nominal import replay
from mavcompass.gap.trial.vehicles import make_case


@pytest.mark.parametrize("seed", [41, 304241175])
def test_a_heading_scatters_as_readings_do_behind_their_calibration(seed: int) -> None:
    here = replay(make_case(seed, "none").track)
    field, rng = here.measured.mag_mgauss, np.random.default_rng(seed)
    told = 0.5 * rms(heading_scatter(here, field))
    drawn = [
        rms(heading_error_rad(here, field + 0.5 * rng.standard_normal(field.shape), field)) for _ in range(20)
    ]
    assert told == pytest.approx(float(np.mean(drawn)), rel=0.03)


def fitted(J: FloatArray, readings: FloatArray) -> tuple[Any, Any]:
    """Fit amplitudes of unit variance to readings (N, 3) of unit noise with the derivatives J (3 N, k)."""
    covariance = np.linalg.inv(J.T @ J + np.eye(J.shape[1]))
    predicted = (J @ (covariance @ (J.T @ readings.ravel()))).reshape(-1, 3)
    problem = SimpleNamespace(
        replay=SimpleNamespace(
            groups=("mag",),
            doubtful={},
            measured=SimpleNamespace(mag_mgauss=readings),
            valid=np.ones(len(readings), dtype=np.bool_),
            reference=SimpleNamespace(kind="columns"),
            resolution_mgauss=0.0,
        ),
        groups=("mag",),
        nuisances=(None,),
        noise={"mag": SimpleNamespace(channels=None)},
        jacobian=lambda fit: J,
        predict=lambda fit: SimpleNamespace(mag_mgauss=predicted),
    )
    return problem, SimpleNamespace(covariance=covariance, terms=(), thetas=(), nuisance_thetas=())


@pytest.mark.parametrize("count", [0, 30, 120])
def test_noise_is_measured_alike_beside_few_and_many_curves(count: int) -> None:
    """A hundred curves through eighty readings take a third of their scatter along."""
    noises = []
    for seed in range(20):
        rng = np.random.default_rng([seed, count])
        J = 3.0 * rng.normal(size=(240, count))
        readings = (J @ rng.normal(size=count)).reshape(-1, 3) + rng.normal(size=(80, 3))
        noises.append(measured_noise(*fitted(J, readings))["mag"].rms)
    assert float(np.sqrt(np.mean(np.square(noises)))) == pytest.approx(1.0, abs=0.06)
