"""What the numbers must not depend on: order of compasses, side of the globe, threads; their derivatives."""

from __future__ import annotations

import hashlib
import math
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from calibration_worlds import FIELD, Iron, four_positions, heading_errors, iron_of, rms, turning_track
from hypothesis import given, settings
from hypothesis import strategies as st

from mavcompass import blas
from mavcompass.calibration import calibrate_track, solve_four_positions
from mavcompass.calibration.methods.ellipsoid import _length_jacobian
from mavcompass.calibration.model import (
    GAIN,
    HEADINGS,
    HORIZONTAL,
    VERTICAL,
    by_tilt,
    gain_jacobian,
    gain_matrix,
    heading_gradient,
)
from mavcompass.calibration.motion.sections import Sections
from mavcompass.calibration.positions import PositionProblem
from mavcompass.calibration.positions.problem import fit_positions
from mavcompass.calibration.rigid import DEFAULT_PRIOR
from mavcompass.correction import IDENTITY, FieldCorrection
from mavcompass.earth_field import EarthField, decimal_year, earth_field, middle_place
from mavcompass.errors import PoorCalibration
from mavcompass.frames import FloatArray, level_to_body, wrap_pi
from mavcompass.heading.compute import tilt_compensated_heading

FEW = settings(max_examples=25, deadline=None, derandomize=True)
SEEDS = st.integers(0, 10**6)
BENT = FieldCorrection((60.0, -40.0, 25.0), (1.05, 0.95, 1.02), (0.01, -0.02, 0.015))


def derivative(function: Callable[[FloatArray], FloatArray], x: FloatArray) -> FloatArray:
    """Differences over a step of each number's own size, (.., P)."""
    columns = []
    for place in range(x.size):
        step = np.zeros(x.size)
        step[place] = 1e-5 * max(abs(x[place]), 1.0)
        columns.append((function(x + step) - function(x - step)) / (2.0 * step[place]))
    return np.stack(columns, axis=-1)


def is_derivative(closed: FloatArray, numeric: FloatArray) -> bool:
    size = np.abs(numeric).max()
    return bool(np.allclose(closed, numeric, rtol=1e-5, atol=1e-6 * size))


@FEW
@given(SEEDS)
def test_gains_and_headings_have_their_derivatives(seed: int) -> None:
    rng = np.random.default_rng(seed)
    vectors = rng.normal(0.0, 300.0, (3, 3))
    gain = np.r_[rng.uniform(0.7, 1.4, 3), rng.uniform(-0.1, 0.1, 3)]
    numeric = derivative(lambda g: vectors @ gain_matrix(g), gain)
    assert is_derivative(gain_jacobian(vectors), numeric)

    state = np.zeros(16)
    state[GAIN], state[HORIZONTAL], state[VERTICAL] = gain, rng.uniform(20.0, 400.0), rng.normal(0.0, 400.0)
    psi, roll, pitch = rng.uniform(-3.0, 3.0), *rng.uniform(-0.5, 0.5, 2)
    level = np.array([state[HORIZONTAL] * math.cos(psi), -state[HORIZONTAL] * math.sin(psi), state[VERTICAL]])
    raw = gain_matrix(gain) @ (level_to_body(roll, pitch) @ level)

    def heading(error: FloatArray) -> FloatArray:
        """By a compass whose offsets and gains are known wrongly by `error`."""
        field = np.linalg.solve(gain_matrix(gain + error[3:]), raw - error[:3])
        seen = tilt_compensated_heading(field, roll_rad=roll, pitch_rad=pitch)
        return np.atleast_1d(wrap_pi(seen - psi))

    closed = heading_gradient(state, psi, roll, pitch)
    assert np.allclose(np.abs(closed), np.abs(derivative(heading, np.zeros(9))), rtol=1e-3, atol=1e-6)


@FEW
@given(SEEDS)
def test_the_length_of_the_field_has_its_derivative(seed: int) -> None:
    rng = np.random.default_rng(seed)
    raw = rng.normal(0.0, 300.0, (7, 3))
    x = np.r_[rng.normal(0.0, 50.0, 3), rng.uniform(0.8, 1.2, 3), rng.uniform(-0.1, 0.1, 3)]
    _, closed = _length_jacobian(raw, x, 500.0)
    assert is_derivative(closed, derivative(lambda y: _length_jacobian(raw, y, 500.0)[0], x))


@FEW
@given(SEEDS)
def test_sections_and_turns_have_their_derivatives(seed: int) -> None:
    rng = np.random.default_rng(seed)
    sections = drawn_sections(rng, 4)
    x = np.zeros(HEADINGS + 4 + 6)
    x[GAIN], x[HORIZONTAL], x[VERTICAL] = (1.1, 0.9, 1.0, 0.02, -0.01, 0.03), 230.0, -520.0
    x[:3], x[13:HEADINGS] = rng.normal(0.0, 50.0, 3), 0.01 * rng.normal(size=HEADINGS - 13)
    x[HEADINGS:] = rng.uniform(-3.0, 3.0, 10)
    assert is_derivative(-sections.field(x)[1], derivative(lambda y: sections.field(y)[0], x))
    assert is_derivative(sections.turns(x)[1], derivative(lambda y: sections.turns(y)[0], x))


@FEW
@given(SEEDS)
def test_a_tilted_section_reads_what_its_derivative_says(seed: int) -> None:
    rng = np.random.default_rng(seed)
    sections, h = drawn_sections(rng, 4), 1e-6
    x = np.zeros(HEADINGS + 4 + 6)
    x[GAIN], x[HORIZONTAL], x[VERTICAL] = (1.1, 0.9, 1.0, 0.02, -0.01, 0.03), 230.0, -520.0
    x[HEADINGS : HEADINGS + 4] = rng.uniform(-3.0, 3.0, 4)
    by = by_tilt(sections.mapping, x, x[HEADINGS : HEADINGS + 4])
    for axis in range(2):
        turned = replace(sections, mapping=level_to_body(*(h * np.eye(2)[axis])) @ sections.mapping)
        moved = sections.field(x)[0] - turned.field(x)[0]
        assert np.allclose(moved / h, by[:, :, axis], atol=0.01)


def drawn_sections(rng: np.random.Generator, count: int) -> Sections:
    """Sections with any numbers in them: only the equations are looked at."""
    given = {
        "mean_mgauss": rng.normal(0.0, 300.0, (count, 3)),
        "mapping": level_to_body(*rng.uniform(-0.3, 0.3, (2, count))),
        "by_lag": rng.normal(0.0, 0.3, (count, 3, 3)),
        "loads": rng.uniform(0.0, 5.0, (count, 3)),
        "turned_rad": np.cumsum(rng.uniform(-1.5, 1.5, count)),
        "step_sigma_rad": rng.uniform(0.001, 0.05, count - 1),
        "middle_s": 10.0 * np.arange(count) + 2.5,
        "start_s": 10.0 * np.arange(count),
        "end_s": 10.0 * np.arange(count) + 5.0,
    }
    rest = {field.name: np.zeros(count) for field in fields(Sections) if field.name not in given}
    return Sections(**{**rest, **given})


def least_eigenvalue(seed: list[int]) -> float | None:
    """Draw and solve a problem; return the least eigenvalue of its correlations, None where it is refused."""
    rng = np.random.default_rng(seed)
    turns = rng.uniform(-2.5, 2.5, int(rng.integers(2, 8)))
    hard, soft = rng.normal(0.0, 200.0, 3), np.eye(3) + rng.normal(0.0, 0.15, (3, 3))
    data = four_positions(
        Iron((float(hard[0]), float(hard[1]), float(hard[2])), soft),
        rng,
        turns=turns,
        noise=3.0,
        gyro_sigma=0.01,
        gyro_scale_sigma=0.01,
        tilt=float(rng.uniform(0.0, 0.2)),
    )
    try:
        problem = PositionProblem.of(data, IDENTITY, FIELD, DEFAULT_PRIOR)
    except PoorCalibration:
        return None
    covariance = fit_positions(problem).covariance
    if not np.isfinite(covariance).all() or not (np.diag(covariance) > 0.0).all():
        return float("-inf")
    scale = 1.0 / np.sqrt(np.diag(covariance))
    return float(np.linalg.eigvalsh(covariance * np.outer(scale, scale)).min())


def test_the_covariance_is_positive_definite_whatever_was_visited(more: int) -> None:
    """Of two to seven stops and any steps between them, iron up to half of the field, tilt up to 0.2 rad."""
    found = [least_eigenvalue([7, number]) for number in range(60 * more)]
    solved = [least for least in found if least is not None]
    assert len(solved) > 30 * more and min(solved) > 0.0


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("horizontal", [400.0, 232.0, 60.0])
@pytest.mark.parametrize("down", [0.0, 530.0])
def test_north_south_and_the_magnetic_equator_are_alike(side: float, horizontal: float, down: float) -> None:
    earth = EarthField((horizontal, 0.0, side * down))
    fit = solve_four_positions(four_positions(iron_of(BENT), earth=earth), earth=earth)
    assert rms(heading_errors(fit.correction, iron_of(BENT), earth=earth)) < 20.0 / horizontal


def test_at_a_magnetic_pole_it_is_said_that_no_compass_works() -> None:
    earth = earth_field(86.0, 140.0, 0.0, 2026.5)  # the northern one of these years
    assert earth.horizontal_mgauss < 30.0
    track = turning_track(iron_of(BENT), noise=1.0)
    strange = calibrate_track(track, method="four-positions", earth=earth)
    assert not strange.accepted
    assert strange.reasons


@pytest.mark.parametrize("lat", [90.0, -90.0])
def test_the_poles_are_places(lat: float) -> None:
    earth = earth_field(lat, 0.0, 0.0, 2026.5)
    assert 400.0 < earth.total_mgauss < 700.0 and all(map(math.isfinite, earth.ned_mgauss))


def test_the_date_line_is_no_edge() -> None:
    west, east = np.array([-17.0, -179.999, 3.0]), np.array([-17.0, 179.999, 5.0])
    for places in ([west, west, east, east], [west, west, west, east], [east, east, west, [np.nan] * 3]):
        lat, lon, alt = middle_place(np.array(places))
        assert lat == -17.0 and abs(lon) > 179.99 and 3.0 <= alt <= 5.0
    assert middle_place(np.array([[1.0, 10.0, 0.0], [1.0, -20.0, 0.0]])) == (1.0, -5.0, 0.0)
    near, far = earth_field(-17.0, 179.999, 0.0, 2026.5), earth_field(-17.0, -179.999, 0.0, 2026.5)
    assert np.allclose(near.ned_mgauss, far.ned_mgauss, atol=0.02)


def test_the_year_goes_on_over_new_year() -> None:
    new_year_s = 1_798_761_600.0  # 2027-01-01 UTC
    before, after = decimal_year(new_year_s - 1.0), decimal_year(new_year_s + 1.0)
    assert 0.0 < after - before < 1e-6 and decimal_year(new_year_s) == 2027.0
    there = [earth_field(47.0, 8.0, 400.0, year).ned_mgauss for year in (before, after)]
    assert np.allclose(*there, atol=1e-4)


def test_the_order_of_the_compasses_changes_nothing() -> None:
    track = turning_track(iron_of(BENT))
    other = turning_track(Iron((-30.0, 80.0, 10.0)), seed=2)
    both = {1: track.compasses[1], 2: other.compasses[1]}
    forward = replace(track, compasses=both)
    backward = replace(track, compasses=dict(reversed(both.items())))
    for instance in (1, 2):
        there, back = (calibrate_track(t, "four-positions", instance=instance) for t in (forward, backward))
        assert there.correction == back.correction
        assert np.array_equal(there.covariance, back.covariance)


SOLVES = """
import sys; sys.path.insert(0, sys.argv[1])
from calibration_worlds import iron_of, turning_track
from mavcompass.calibration import calibrate_track
from mavcompass.correction import FieldCorrection
for method in ("four-positions", "world-field"):
    track = turning_track(iron_of(FieldCorrection((60.0, -40.0, 25.0), (1.05, 0.95, 1.02))))
    result = calibrate_track(track, method)
    print(repr(result.correction), result.covariance.tobytes().hex(), result.reasons)
"""


def test_one_thread_and_two_give_the_same_bytes() -> None:
    digests = set()
    for threads in ("1", "2"):
        names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
        environment = {**os.environ, **dict.fromkeys(names, threads)}
        said = subprocess.run(
            [sys.executable, "-c", SOLVES, str(Path(__file__).parent)],
            env=environment,
            capture_output=True,
            check=True,
        ).stdout
        assert said
        digests.add(hashlib.sha256(said).hexdigest())
    assert len(digests) == 1


def test_matrix_products_of_a_calibration_have_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    setter = Mock()
    monkeypatch.setattr(blas, "_libraries", lambda: ((setter, lambda: 7),))
    calibrate_track(turning_track(iron_of(FieldCorrection((60.0, -40.0, 25.0)))), "four-positions")
    counts = [call.args[0] for call in setter.call_args_list]
    assert counts[0] == 1 and counts[-1] == 7
