"""Motors that reverse, readings that are missing: what they hid is told."""

from __future__ import annotations

import numpy as np
import pytest

from mavcompass.gap.diagnose import diagnose_gap
from mavcompass.gap.replay.nominal import replay
from mavcompass.gap.trial.vehicles import make_case
from mavcompass.simulation.effects import catalogue


def test_readings_that_stay_scatter_no_more_than_the_like_of_the_baseline() -> None:
    case = make_case(305923872, "single")
    assert [name for name, _ in case.effects] == ["stale_samples"]
    found = diagnose_gap(case.track, case.baseline)
    assert found.verdict in ("named", "ambiguous") and found.effects == {"stale_samples"}
    assert case.baseline is not None
    assert replay(case.baseline, period_s=0.1).averaged > 1
    assert replay(case.baseline, period_s=0.1, most_averaged=1).averaged == 1


def test_motors_that_reverse_work_either_way_and_switch_by_their_direction() -> None:
    track = make_case(88021, "none", baseline=False).track
    rover = replay(track)
    motors = rover.signals.stimulus.motors
    assert track.vehicle == "rover" and motors.min() < -0.02 < 0.1 < motors.max()
    every = catalogue()
    share = every["per_motor"].neutral()
    share[:3] = 10.0, 0.0, 0.0
    worked = every["per_motor"].forward(rover.signals, share, {}, None).reading.mag_mgauss
    assert worked[:, 0] - rover.signals.reading.mag_mgauss[:, 0] == pytest.approx(10.0 * np.abs(motors[:, 0]))
    back = every["relay_field"].forward(rover.signals, np.array([0.0, 0.0, 7.0, 2.0, -0.01]), {}, None)
    closed = (back.reading.mag_mgauss - rover.signals.reading.mag_mgauss)[:, 2] > 3.0
    assert np.array_equal(closed, motors[:, 0] > -0.01) and 0.0 < closed.mean() < 1.0


def test_a_reference_a_degree_below_all_that_was_recorded_is_found() -> None:
    case = make_case(212410973, "single")
    (name, truth), *_ = case.effects
    assert name == "temperature_bias" and case.track.temperature_degc is not None
    assert truth["reference_degc"] < float(case.track.temperature_degc.values.min()) - 1.0
    found = diagnose_gap(case.track, case.baseline)
    assert found.verdict == "named" and found.effects == {"temperature_bias"}
    (cause,) = found.causes
    assert cause.parameters["reference_degc"] == pytest.approx(truth["reference_degc"], abs=0.5)
    assert cause.parameters["x"] == pytest.approx(truth["x"], rel=0.03)


def test_a_compass_that_stays_nearly_all_the_time_is_a_finding_and_no_lack_of_readings() -> None:
    case = make_case(525895344, "single")
    assert [name for name, _ in case.effects] == ["stale_samples"]
    reported = case.track.compasses[1].reported.values
    new = int((np.diff(reported, axis=0) != 0.0).any(axis=1).sum()) + 1
    assert new < 60 < len(reported)
    found = diagnose_gap(case.track, case.baseline)
    assert found.verdict in ("named", "ambiguous") and found.effects == {"stale_samples"}
