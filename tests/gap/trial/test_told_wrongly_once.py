"""Vehicles that once were told wrongly: what was put in is named, and how large it is."""

from __future__ import annotations

import numpy as np
import pytest

from mavcompass.gap.diagnose import diagnose_gap
from mavcompass.gap.replay.nominal import replay
from mavcompass.gap.trial.cases import Generator, case_of
from mavcompass.gap.trial.vehicles import make_case
from mavcompass.simulation.effects import catalogue


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


@pytest.mark.parametrize(
    ("maker", "seed", "effect", "sure", "within"),
    [
        ("vehicles", 305923872, "stale_samples", False, {}),  # they scatter no more than in the baseline
        ("vehicles", 525895344, "stale_samples", False, {}),  # less than 60 readings are new
        # A reference a degree below all that was recorded.
        ("vehicles", 212410973, "temperature_bias", True, {"reference_degc": 0.5, "x": 0.18}),
        # The rows about it are set aside.
        ("vehicles", 2116634633, "hard_iron_step", True, {"on_s": 0.2, "x": 1.0, "y": 1.0, "z": 1.0}),
        ("vehicles", 304241175, "set_reset_offset", True, {}),  # averaged rows hide it
        ("another", 979059, "hard_iron_step", True, {"on_s": 0.05}),  # one reading was on its wrong side
        ("another", 979022, "soft_iron", True, {"xy": 0.002}),  # before the oblique axes that are in force
        ("another", 979047, "soft_iron", True, {"xz": 0.002}),  # means of a gyro that swings
        # So much a motor's field per ampere differs on no other day.
        ("another", 979010, "motor_current", False, {"y": 0.1}),
        ("another", 979083, "noise_excess", True, {"sigma_mgauss": 0.2}),  # nothing else is there
    ],
)
def test_what_was_put_in_is_named(
    maker: Generator, seed: int, effect: str, sure: bool, within: dict[str, float]
) -> None:
    case = case_of(maker, "single", seed)
    ((name, truth),) = case.effects
    found = diagnose_gap(case.track, case.baseline)
    assert name == effect and found.effects == {effect}
    assert found.verdict == "named" or (found.verdict == "ambiguous" and not sure)
    assert not sure or found.field.after < 1.25 * found.field.floor
    for parameter, least in within.items():
        assert found.causes[0].parameters[parameter] == pytest.approx(truth[parameter], abs=least)


@pytest.mark.parametrize("seed", [1208850555, 1042849402])
def test_gyro_stays_what_it_is_where_a_turned_compass_leans_the_autopilot(seed: int) -> None:
    case = make_case(seed, "single")
    assert [effect for effect, _ in case.effects] == ["orientation"] and case.baseline is not None
    flight, before = (replay(track).reference.errors["gyro offset"] for track in (case.track, case.baseline))
    np.testing.assert_allclose(flight.mean, before.mean, atol=0.006)


@pytest.mark.parametrize("seed", [471040, 473048])
def test_a_compass_whose_readings_are_means_is_smoothed_by_nothing_else(seed: int) -> None:
    """A baseline is too short to show what a longer drive does: they are means of a tenth of a second."""
    case = make_case(seed, "none")
    assert diagnose_gap(case.track, case.baseline).verdict == "no_gap"
