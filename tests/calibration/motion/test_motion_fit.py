"""The fit of a motion on made-up sections: its parts against closed forms, and what it may claim."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mavcompass.calibration.model import HEADINGS, LAG, MOTOR, OFFSET, gain_matrix
from mavcompass.calibration.motion import fit, honesty
from mavcompass.calibration.motion.fit import ModelError, MotionFit, begin, section_variance
from mavcompass.calibration.motion.left_out import last_stretch
from mavcompass.calibration.motion.observed import Motion
from mavcompass.calibration.motion.sections import Sections
from mavcompass.calibration.rigid import DEFAULT_PRIOR
from mavcompass.correction import IDENTITY, FieldCorrection
from mavcompass.earth_field import EarthField
from mavcompass.errors import PoorCalibration
from mavcompass.frames import FloatArray, euler_to_matrix, wrap_pi

DEG = math.radians(1.0)
EARTH = EarthField((200.0, 0.0, 450.0))
OFFSETS = np.array([60.0, -40.0, 25.0])
GAINS = np.array([1.08, 0.93, 1.0, 0.02, 0.0, 0.0])
K = 24


def sections_of(
    psi: FloatArray | None = None,
    noise: float = 0.0,
    load: FloatArray | None = None,
    motor: tuple[float, float, float] = (0.0, 0.0, 0.0),
    **changed: Any,
) -> Sections:
    """Make sections at headings (K,), each of 20 readings in two seconds, level and by a good gyro."""
    psi = np.linspace(0.3, 0.3 + 2.0 * math.pi, K, endpoint=False) if psi is None else psi
    k = psi.size
    load = np.zeros(k) if load is None else load - load.mean()
    level = np.stack([200.0 * np.cos(psi), -200.0 * np.sin(psi), np.full(k, 450.0)], axis=1)
    mean = OFFSETS + level @ gain_matrix(GAINS) + load[:, np.newaxis] * motor
    mean = mean + noise * np.random.default_rng(3).normal(size=mean.shape)
    values: dict[str, Any] = {
        "start_s": 3.0 * np.arange(k),
        "end_s": 3.0 * np.arange(k) + 2.0,
        "mean_mgauss": mean,
        "samples": np.full(k, 20.0),
        "noise_mgauss": 1.0,
        "hidden_mgauss": np.zeros((k, 3)),
        "mapping": np.tile(np.eye(3), (k, 1, 1)),
        "by_lag": np.zeros((k, 3, 3)),
        "tilt_sigma_rad": np.full(k, 1e-4),
        "tilt_bias_rad": 0.001,
        "turned_rad": psi - psi[0],
        "step_sigma_rad": np.full(k - 1, 0.002),
        "bias_sigma_radps": 1e-4,
        "scale_sigma": 0.01,
        "load": load,
        "load_mean": 0.0,
        "repeats": np.ones(k),
        "gyro_rate_hz": 50.0,
        **changed,
    }
    values.setdefault("middle_s", 0.5 * (values["start_s"] + values["end_s"]))
    return Sections(**values)


def known(earth: EarthField | None, in_force: FieldCorrection = IDENTITY) -> Any:
    return SimpleNamespace(earth=earth, prior=DEFAULT_PRIOR, in_force=in_force, track=None)


def fit_of(
    sections: Sections,
    earth: EarthField | None = None,
    load_source: Any = "none",
    in_force: FieldCorrection = IDENTITY,
) -> MotionFit:
    return fit.fit_motion(known(earth, in_force), sections, load_source)


@pytest.fixture(scope="module")
def found() -> MotionFit:
    return fit_of(sections_of(), EARTH)


def disturbed(index: int = 5, mgauss: float = 30.0) -> Sections:
    sections = sections_of(noise=0.2)
    sections.mean_mgauss[index] += [0.0, mgauss, 0.0]
    return sections


def test_exact_sections_give_the_iron_the_headings_and_no_model_error(found: MotionFit) -> None:
    # A level circle does not tell z's offset from its gain: the prior does.
    assert found.offset_mgauss[:2] == pytest.approx(OFFSETS[:2], abs=0.05)
    assert found.gain == pytest.approx(gain_matrix(GAINS), abs=5e-3)
    assert found.headings_rad == pytest.approx(0.3 + sections_of().turned_rad, abs=1e-4)
    assert found.error.mgauss == 0.0 and found.sound.min() > 0.999
    assert np.abs(found.residual_mgauss).max() < 0.05
    assert found.jacobian.shape[1] == HEADINGS + K and len(found.jacobian) == found.whitened.size
    assert found.information @ found.covariance == pytest.approx(np.eye(HEADINGS + K), abs=1e-3)
    assert fit.residual_of(sections_of(), found) == pytest.approx(found.residual_mgauss, abs=0.05)
    by_lag = np.tile(4.0 * np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]), (K, 1, 1))
    late = replace(found, state=np.where(np.arange(HEADINGS + K) == LAG, 0.04, found.state))
    assert np.abs(fit.residual_of(sections_of(by_lag=by_lag), late)).max() < 4.0  # its heading is as late
    there = fit.level_headings(sections_of(), found)
    assert wrap_pi(there - found.headings_rad) == pytest.approx(np.zeros(K), abs=1e-4)


def test_an_attitude_that_errs_is_no_iron_that_changed() -> None:
    psi, rng = np.linspace(0.3, 0.3 + 4.0 * math.pi, 48, endpoint=False), np.random.default_rng(7)
    tilt, error = rng.uniform(-1.0, 1.0, (2, 48)), rng.normal(0.0, 0.1, (2, 48))
    leant, told = (np.array([euler_to_matrix(r, p, 0.0).T for r, p in a.T]) for a in (tilt, tilt + error))
    level = np.stack([200.0 * np.cos(psi), -200.0 * np.sin(psi), np.full(48, 450.0)], axis=1)
    mean = OFFSETS + np.einsum("kij,kj->ki", leant, level) @ gain_matrix(GAINS)
    sections = sections_of(psi, mean_mgauss=mean, mapping=told)
    motion = Motion(known(None), None, None, sections, fit_of(sections), "none")  # type: ignore[arg-type]
    assert last_stretch(motion) == (motion, None)


def test_fewer_than_four_sections_are_refused() -> None:
    four = sections_of(np.array([0.3, 1.9, 3.5, 5.0]))
    assert fit_of(four, EARTH).offset_mgauss[:2] == pytest.approx(OFFSETS[:2], abs=0.5)
    with pytest.raises(PoorCalibration, match="Only 3 stretches of the recording have compass and gyro"):
        fit_of(four.chosen(np.arange(3)), EARTH)


def test_without_a_world_the_vertical_offset_is_the_one_in_force() -> None:
    in_force = FieldCorrection(offsets_mgauss=(-60.0, 40.0, -25.0))
    alone = fit_of(sections_of(), None, "none", in_force)
    assert alone.offset_mgauss == pytest.approx(OFFSETS, abs=1.5)
    assert fit_of(sections_of()).offset_mgauss[2] == pytest.approx(0.0, abs=1.5)


@pytest.mark.parametrize("source", ["current", "throttle"])
def test_a_motor_field_is_found_beside_the_load(source: str) -> None:
    load = np.resize([0.0, 7.0, 2.0, 10.0, 4.0], K)
    motor = (1.5, -1.0, 0.5)
    seen = fit_of(sections_of(load=load, motor=motor), EARTH, source)
    assert seen.state[MOTOR] == pytest.approx(motor, abs=0.02)
    shifted = sections_of(load=load, motor=motor)
    elsewhere = replace(shifted, load=shifted.load - 3.0)  # as a half with another mean has it
    there = fit.level_headings(elsewhere, seen, -3.0)
    assert wrap_pi(there - seen.headings_rad) == pytest.approx(np.zeros(K), abs=1e-3)
    none = fit_of(sections_of(load=load), EARTH)
    assert np.abs(none.state[MOTOR]).max() < 1e-5
    # Before the data: 10 mG/A, 100 mG at full throttle.
    blind = sections_of(load=1e-9 * load)
    sigma = math.sqrt(fit_of(blind, EARTH, source).covariance[13, 13])
    wide = {"current": 10.0, "throttle": 100.0}[source]
    assert sigma == pytest.approx(wide, rel=1e-3)


def test_a_passing_magnet_is_kept_out() -> None:
    seen = fit_of(disturbed(), EARTH)
    assert seen.sound[5] < 0.01 and np.delete(seen.sound, 5).min() > 0.95
    assert seen.offset_mgauss[:2] == pytest.approx(OFFSETS[:2], abs=0.6)
    assert seen.residual_mgauss[5] == pytest.approx([0.0, 30.0, 0.0], abs=1.5)


def test_what_is_wrong_everywhere_is_an_error_of_the_model() -> None:
    seen = fit_of(sections_of(noise=6.0), EARTH)
    assert seen.error.mgauss == pytest.approx(6.0, rel=0.25) and seen.sound.min() > 0.5
    calm = fit_of(sections_of(noise=0.2), EARTH)  # as one reading's noise of 1 mG makes of twenty
    assert calm.error.mgauss == 0.0
    assert fit.sigma_of(seen) > 10.0 * fit.sigma_of(calm)


def test_the_sigma_is_the_scatter_of_fits() -> None:
    clean = sections_of()
    chance = np.random.default_rng(8)
    off = []
    for _ in range(10):
        noisy = replace(
            clean, mean_mgauss=clean.mean_mgauss + chance.normal(0.0, 1.0 / math.sqrt(20.0), (K, 3))
        )
        off.append(fit_of(noisy, EARTH).offset_mgauss[:2])
    claimed = np.sqrt(np.diag(fit_of(clean, EARTH).covariance)[:2])
    assert np.std(off, axis=0) == pytest.approx(claimed, rel=0.5)


def test_an_accelerometers_error_is_an_offset_by_the_dip(found: MotionFit) -> None:
    by_roll, by_pitch = fit.leaning_error(sections_of(), found).T
    # On the level: roll turns Z into y, pitch into x; T is nearly one.
    # What a cross term of z takes up, the offset has to give back.
    assert abs(by_roll[1] + 450.0 * by_roll[8]) == pytest.approx(0.45 * 0.93, abs=0.01)
    assert abs(by_pitch[0] + 450.0 * by_pitch[7]) == pytest.approx(0.45 * 1.08, abs=0.01)
    assert np.abs([by_roll[0], by_pitch[1]]).max() < 0.02
    still = replace(sections_of(), tilt_bias_rad=0.0)
    assert not fit.leaning_error(still, found).any()


def test_a_sections_variance_is_noise_steps_tilt_and_model(found: MotionFit) -> None:
    sections = sections_of(
        hidden_mgauss=np.full((K, 3), 0.3), tilt_sigma_rad=np.full(K, 0.01), repeats=np.full(K, 2.0)
    )
    single = section_variance(sections, found.state, ModelError(2.0), weighed=False)
    both = section_variance(sections, found.state, ModelError(2.0))
    white = np.eye(3) / 20.0
    assert both - white == pytest.approx(2.0 * (single - white))
    # At heading 0.3: roll moves y by Z, and z by the field across; T on the outside.
    body = np.array([200.0 * math.cos(0.3), -200.0 * math.sin(0.3), 450.0])
    roll, pitch = np.array([0.0, body[2], -body[1]]), np.array([-body[2], 0.0, body[0]])
    lean = np.stack([roll, pitch], axis=1) * 0.01
    gain = gain_matrix(GAINS)
    expected = gain @ lean @ lean.T @ gain.T + (4.0 + 0.09) * np.eye(3) + white
    assert single[0] == pytest.approx(expected, abs=0.05)


@pytest.mark.parametrize("first", [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
def test_the_first_state_is_near_wherever_the_vehicle_begins(first: float) -> None:
    psi = first + np.linspace(0.0, 2.0 * math.pi, K, endpoint=False)
    for earth in (EARTH, None):
        x, _, _ = begin(known(earth), sections_of(psi))
        assert np.abs(np.angle(np.exp(1j * (x[HEADINGS:] - psi)))).max() < 20.0 * DEG
        assert x[OFFSET][:2] == pytest.approx(OFFSETS[:2], abs=30.0)


def motion_of(sections: Sections, seen: Any) -> Any:
    return SimpleNamespace(sections=sections, fit=seen)


def test_what_is_claimed_is_at_least_what_scatters() -> None:
    calm = honesty.weigh_honestly(sections_of(noise=0.2), fit_of(sections_of(noise=0.2), EARTH))
    assert calm.scatter_rad == 0.0
    # Noise and the accelerometer's own error: what is left out moves it by no more than chance.
    assert calm.error.rms_rad() == pytest.approx(math.hypot(calm.noise_rad, calm.accelerometer_rad), rel=1e-6)
    assert calm.accelerometer_rad == pytest.approx(0.001 * 450.0 / 200.0, rel=0.05)
    rough = honesty.weigh_honestly(sections_of(noise=6.0), fit_of(sections_of(noise=6.0), EARTH))
    assert rough.scatter_rad == pytest.approx(6.0 / 200.0, rel=0.4)
    assert rough.error.rms_rad() >= rough.scatter_rad > rough.noise_rad
    wider = calm.at_least(0.05)
    assert wider.scatter_rad == 0.05 and wider.error.rms_rad() == pytest.approx(0.05)
    assert calm.at_least(-1.0) is calm
    assert calm.at_least(1e-5).error.rms_rad() == pytest.approx(calm.error.rms_rad())  # never narrower


def test_motors_that_are_left_scatter_the_heading(found: MotionFit) -> None:
    load = np.where(np.arange(K) % 2, 5.0, -5.0)
    sections = replace(sections_of(), load=load)
    left = honesty.motors_left_rad(sections, found, np.array([3.0, 4.0, 99.0]))
    # 5 mG/A at 5 A, of which half the square lies across the nose, over the field as the compass reads it.
    assert left == pytest.approx(math.sqrt(0.5) * 25.0 / (200.0 * 0.5 * (1.08 + 0.93)), rel=1e-3)
    unsure = replace(found, covariance=9.0 * np.eye(HEADINGS + K))
    assert (
        honesty.motors_left_rad(sections, unsure, np.array([5.9, 5.9, 0.0])) == 0.0
    )  # two sigmas are chance
    assert honesty.motors_left_rad(sections, unsure, np.array([6.1, 0.0, 0.0])) > 0.0
    often = replace(sections, repeats=np.where(load > 0.0, 4.0, 1.0), load=np.where(load > 0.0, 5.0, 0.0))
    assert honesty.motors_left_rad(often, found, np.array([4.0, 0.0, 0.0])) == pytest.approx(
        math.sqrt(0.5 * 0.2) * 20.0 / 201.0, rel=1e-3
    )
