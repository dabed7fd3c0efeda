"""The heading scatter that a correction leaves, second by second, and sections as a table of rows."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mavcompass.calibration.model import HEADINGS, HORIZONTAL, LAG, VERTICAL
from mavcompass.calibration.motion.honesty import gyro_scatter_rad
from mavcompass.calibration.motion.sections import Sections, unsettled
from mavcompass.calibration.observation.turning import TurnRecord
from mavcompass.calibration.recorded import Recorded
from mavcompass.correction import FieldCorrection
from mavcompass.frames import FloatArray
from mavcompass.track import InForce, MagSeries, Series, Track

DEG = math.radians(1.0)
TIME = np.arange(400.0) * 0.1
K = 8


def sections_of(**changed: Any) -> Sections:
    """Make eight sections of five seconds, 45 degrees apart, by a compass without noise."""
    rows: dict[str, Any] = {
        "start_s": 5.0 * np.arange(K),
        "end_s": 5.0 * np.arange(K) + 5.0,
        "mean_mgauss": np.zeros((K, 3)),
        "samples": np.full(K, 50.0),
        "noise_mgauss": 1e-6,
        "hidden_mgauss": np.zeros((K, 3)),
        "mapping": np.tile(np.eye(3), (K, 1, 1)),
        "by_lag": np.zeros((K, 3, 3)),
        "tilt_sigma_rad": np.zeros(K),
        "tilt_bias_rad": 0.0,
        "turned_rad": 45.0 * DEG * np.arange(K),
        "step_sigma_rad": np.full(K - 1, 0.001),
        "bias_sigma_radps": 0.0,
        "scale_sigma": 0.0,
        "load": np.zeros(K),
        "load_mean": 0.0,
        "repeats": np.ones(K),
        "gyro_rate_hz": 50.0,
        **changed,
    }
    rows.setdefault("middle_s", 0.5 * (rows["start_s"] + rows["end_s"]))
    return Sections(**rows)


ANGLE = 45.0 * DEG * np.floor(TIME / 5.0)


def left_deg(
    off_deg: FloatArray, sections: Sections | None = None, sound: FloatArray | None = None,
    rate_deg_s: float = 0.0, tilt_deg_s: float = 0.0, lag_s: float = 0.0, lean_deg: float = 0.0,
    vertical: float = 0.0,
) -> float:  # fmt: skip
    """Give headings that are off by so much, (400,); return the scatter that is found."""
    psi = ANGLE + 0.3 + off_deg * DEG
    field = np.stack([200.0 * np.cos(psi), -200.0 * np.sin(psi), np.full(400, vertical)], axis=1)
    compass = MagSeries(1, Series.of(TIME, field))
    zero = np.zeros(400)
    record = TurnRecord(
        TIME - lag_s, ANGLE, zero + rate_deg_s * DEG, zero + tilt_deg_s * DEG, 0.0, 0.0, 0.0, 0.0, 0.1
    )
    state = np.zeros(HEADINGS + K)
    state[HORIZONTAL], state[VERTICAL], state[LAG] = 200.0, vertical, lag_s
    state[HEADINGS:] = 0.3 + 45.0 * DEG * np.arange(K)
    fit: Any = SimpleNamespace(
        state=state, sound=np.ones(K) if sound is None else sound, headings_rad=state[HEADINGS:]
    )
    down = np.tile([math.sin(lean_deg * DEG), 0.0, math.cos(lean_deg * DEG)], (400, 1))
    recorded = Recorded(Track(compasses={1: compass}))
    motion: Any = SimpleNamespace(
        recorded=recorded, record=record, sections=sections or sections_of(), fit=fit
    )
    return math.degrees(gyro_scatter_rad(motion, field, down))


SWING = np.where(np.floor(TIME) % 2 == 0, 2.0, -2.0)  # second by second
FLAT = np.zeros(400)


def test_what_follows_the_gyro_scatters_by_nothing() -> None:
    assert left_deg(FLAT) == pytest.approx(0.0, abs=1e-3)
    assert left_deg(FLAT + 7.0) == pytest.approx(0.0, abs=1e-3)  # one offset of all is no scatter


def test_the_scatter_is_the_rms_of_seconds() -> None:
    assert left_deg(SWING) == pytest.approx(2.0, rel=0.02)
    assert left_deg(0.5 * SWING) == pytest.approx(1.0, rel=0.02)
    within = np.where(np.arange(400) % 2 == 0, 2.0, -2.0)  # reading by reading it averages out
    assert left_deg(within) < 0.05


def test_disturbed_sections_do_not_count() -> None:
    only = np.where((TIME >= 10.0) & (TIME < 15.0), SWING, 0.0)
    sound = np.ones(K)
    assert left_deg(only) > 0.5
    sound[2] = 0.0
    assert left_deg(only, sound=sound) == pytest.approx(0.0, abs=0.01)


def test_noise_and_tilt_explain_what_they_can() -> None:
    # 200 mG, ten fresh readings a second: 7 mG make 0.63 degrees; four sigmas of chance beside it.
    assert left_deg(0.2 * SWING, sections_of(noise_mgauss=7.0)) == 0.0
    assert left_deg(SWING, sections_of(noise_mgauss=7.0)) == pytest.approx(
        math.sqrt(4.0 - 0.63**2 * 1.9), rel=0.1
    )
    leaning = sections_of(tilt_sigma_rad=np.full(K, 1.0 * DEG))
    assert left_deg(0.2 * SWING, leaning, vertical=100.0) == 0.0  # a degree at a dip of a half
    assert left_deg(SWING, leaning, vertical=100.0) > 1.8


def test_readings_around_a_change_of_the_parameters_are_unsettled() -> None:
    steps = tuple(InForce(t, FieldCorrection()) for t in (-math.inf, 10.0, 20.0))
    track = Track(compasses={1: MagSeries(1, Series.of(TIME, np.zeros((400, 3))), steps)})
    found = TIME[unsettled(track, 1)]
    assert found.min() == pytest.approx(8.1) and found.max() == pytest.approx(21.9) and found.size == 2 * 39
    plain = Track(compasses={1: MagSeries(1, Series.of(TIME, np.zeros((400, 3))))})
    assert not unsettled(plain, 1).any()


def test_sections_are_cut_by_rows_and_by_time() -> None:
    sections = sections_of(step_sigma_rad=np.arange(7.0))
    part = sections.chosen(np.arange(2, 5))
    assert (
        len(part) == 3
        and part.start_s.tolist() == [10.0, 15.0, 20.0]
        and part.step_sigma_rad.tolist() == [2.0, 3.0]
    )
    assert (
        len(sections.chosen(np.arange(3, 3))) == 0
        and sections.chosen(np.arange(3, 4)).step_sigma_rad.size == 0
    )
    assert sections.between(12.4, 22.6).start_s.tolist() == [10.0, 15.0, 20.0]
    assert sections.between(12.6, 22.4).start_s.tolist() == [15.0]
    assert sections.middle_s.tolist() == [2.5 + 5.0 * k for k in range(8)]
