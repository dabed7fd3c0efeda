"""The fit of a motion on made-up sections: its parts against closed forms, and what it may claim."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mavcompass.calibration.model import HEADINGS, LAG, gain_matrix
from mavcompass.calibration.motion import fit, honesty, sections
from mavcompass.calibration.motion.fit import MotionFit
from mavcompass.calibration.motion.left_out import last_stretch
from mavcompass.calibration.motion.observed import Motion
from mavcompass.calibration.motion.sections import Sections
from mavcompass.calibration.observation import wire
from mavcompass.calibration.rigid import DEFAULT_PRIOR
from mavcompass.correction import IDENTITY, FieldCorrection
from mavcompass.earth_field import EarthField
from mavcompass.errors import PoorCalibration
from mavcompass.frames import FloatArray, euler_to_matrix, wrap_pi
from mavcompass.track import InForce, MagSeries, Series, Track

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
        "loads": load[:, np.newaxis],
        "loads_mean": (0.0,),
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


def test_an_accelerometers_error_is_an_offset_by_the_dip(found: MotionFit) -> None:
    by_roll, by_pitch = fit.leaning_error(sections_of(), found).T
    # On the level: roll turns Z into y, pitch into x; T is nearly one.
    # What a cross term of z takes up, the offset has to give back.
    assert abs(by_roll[1] + 450.0 * by_roll[8]) == pytest.approx(0.45 * 0.93, abs=0.01)
    assert abs(by_pitch[0] + 450.0 * by_pitch[7]) == pytest.approx(0.45 * 1.08, abs=0.01)
    assert np.abs([by_roll[0], by_pitch[1]]).max() < 0.02
    still = replace(sections_of(), tilt_bias_rad=0.0)
    assert not fit.leaning_error(still, found).any()


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


# --- How a motion is cut, and what its sections leave unknown


TIME = np.arange(0.0, 20.0, 0.1)
STILL, LEVEL = np.zeros(TIME.size), np.tile([0.0, 0.0, 1.0], (TIME.size, 1))


def cut(**changed: np.ndarray) -> tuple[list[float], list[int]]:
    """Return when sections begin, and which visit of a heading each belongs to."""
    values = {"time": TIME, "angle": STILL, "down": LEVEL, "load": STILL, **changed}
    edges, visit = sections._edges(
        values["time"], values["angle"], values["down"], values["load"][:, np.newaxis]
    )
    assert edges[-1] == values["time"].size
    return [round(float(values["time"][k]), 1) for k in edges[:-1]], visit.tolist()


def test_a_gap_begins_another() -> None:
    begins, visits = cut(time=np.where(TIME < 2.95, TIME, TIME + 1.1))
    assert 2.9 < begins[1] < 4.2 and visits[-1] >= 1


def test_readings_around_a_change_of_the_parameters_are_unsettled() -> None:
    steps = tuple(InForce(t, FieldCorrection()) for t in (-math.inf, 5.0, 15.0))
    field = Series.of(TIME, np.zeros((TIME.size, 3)))
    found = TIME[sections.unsettled(Track(compasses={1: MagSeries(1, field, steps)}), 1)]
    assert found.min() == pytest.approx(3.1) and found.max() == pytest.approx(16.9) and found.size == 2 * 39
    assert not sections.unsettled(Track(compasses={1: MagSeries(1, field)}), 1).any()


LONG = np.arange(0.0, 800.0, 0.1)
CHANCE = np.random.default_rng(1)
RESTLESS = {
    "turns": {"angle": np.radians(10.0) * LONG},
    "leans": {
        "down": np.stack([np.cos(0.1 * LONG), np.sin(0.1 * LONG), 0.0 * LONG + 1.0], 1) / math.sqrt(2.0)
    },
    "draws current": {"load": np.repeat(CHANCE.uniform(0.0, 10.0, LONG.size // 25), 25)},
    "is heard now and then": {
        "time": LONG + np.repeat(np.cumsum(CHANCE.uniform(0.5, 9.0, LONG.size // 20)), 20)
    },
}


@pytest.mark.parametrize("what", RESTLESS)
def test_what_never_rests_is_cut_more_coarsely_but_no_more_than_need_be(what: str) -> None:
    changed = RESTLESS[what]
    time = changed.get("time", LONG)
    rest = {"time": time, "angle": 0.0 * time, "down": np.tile(LEVEL[0], (time.size, 1)), "load": 0.0 * time}
    begins, _ = cut(**{**rest, **changed})
    assert 110 <= len(begins) <= 160


def test_a_whole_number_that_does_not_move_hides_its_step_on_that_axis() -> None:
    rng = np.random.default_rng(6)
    true = rng.uniform(100.0, 120.0, (300, 3))
    ramp = np.linspace(0.0, 30.0, 40)
    rows = true[:, np.newaxis, :] + np.array([1.0, 0.3, 0.0]) * ramp[:, np.newaxis]  # along x and y, not z
    values = np.trunc(rows.reshape(-1, 3))
    first = np.arange(0, len(values), ramp.size)
    hidden = wire.hidden_in_runs(values, first, 1.0)
    means = np.add.reduceat(values, first) / ramp.size + 0.5
    off = (means - rows.mean(axis=1)).std(axis=0)
    claimed = np.sqrt((hidden**2).mean(axis=0))
    assert off[2] == pytest.approx(claimed[2], rel=0.1) and claimed[2] == pytest.approx(1.0 / math.sqrt(12.0))
    assert claimed[0] < claimed[1] < 0.15 and (off[:2] < claimed[:2]).all()
    assert not wire.hidden_in_runs(values, first, 0.0).any()
