"""The second generator's cases: a healthy vehicle reads the field, each effect changes what it should."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from vehicle_scenes import recorded, scene, vehicle_of

import mavcompass.gap.trial.vehicles as package
from mavcompass.frames import FloatArray as Array
from mavcompass.frames import quaternion_to_matrix, rotate_back, rotvec_to_matrix
from mavcompass.gap.trial.vehicles import Tier, VehicleCase, make_case
from mavcompass.gap.trial.vehicles.cases import CATALOGUE
from mavcompass.gap.trial.vehicles.draw import Vehicle
from mavcompass.gap.trial.vehicles.effects.known import sized
from mavcompass.gap.trial.vehicles.motion import MOTIONS, angles, move
from mavcompass.track import Track

TIERS: tuple[Tier, ...] = ("none", "single", "pair", "outside")
ALLOWED = (
    "mavcompass.gap.trial.vehicles",
    "mavcompass.track",
    "mavcompass.correction",
    "mavcompass.earth_field",
    "mavcompass.frames",
)


def field_in_body(track: Track, field_ned: object) -> Array:
    assert track.truth_q is not None
    return rotate_back(quaternion_to_matrix(track.truth_q.values), np.asarray(field_ned))


def drawn(case: VehicleCase) -> Vehicle:
    assert case.vehicle is not None
    return case.vehicle


@cache
def flight(seed: int, tier: Tier) -> VehicleCase:
    return make_case(seed, tier, baseline=False)


@cache
def healthy(cure: str, count: int = 1) -> list[VehicleCase]:
    """Find healthy cases whose readings are neither averaged nor cut, where the baseline was flown."""
    found = []
    for seed in range(200):
        case = flight(seed, "none")
        vehicle = drawn(case)
        compass = vehicle.compass
        plain = not compass.averaged and not compass.whole and not compass.current_field.any()
        assert case.track.place is not None
        at_home = abs(case.track.place.values[0, 0] - vehicle.site.latitude_deg) < 0.005
        if vehicle.cure == cure and plain and at_home:
            found.append(case)
        if len(found) == count:
            return found
    raise AssertionError(f"no healthy case is cured {cure}")


def test_a_healthy_compass_reads_the_field_to_its_stated_noise() -> None:
    (case,) = healthy("exact")
    off = case.track.compasses[1].reported.values - field_in_body(case.track, drawn(case).site.field_mgauss)
    assert np.all(np.abs(off.mean(axis=0)) < 0.3)
    correction = case.track.compasses[1].in_force[0].correction.matrix
    stated = np.sqrt(
        np.diag(correction @ np.diag(np.square(drawn(case).compass.noise_mgauss)) @ correction.T)
    )
    assert np.all(off.std(axis=0) > 0.9 * stated)
    assert np.all(off.std(axis=0) < 1.3 * stated + 0.5)
    np.testing.assert_array_equal(case.clean_mgauss, case.clean_nominal_mgauss)


def test_two_percent_of_what_the_calibration_cures_stay() -> None:
    (case,) = healthy("two_percent")
    correction = case.track.compasses[1].in_force[0].correction
    left = np.abs(np.asarray(correction.offsets_mgauss) / drawn(case).compass.iron_mgauss + 1.0)
    assert np.all((left > 0.01) & (left < 0.03))
    cured = np.linalg.inv(drawn(case).compass.matrix) - np.eye(3)
    np.testing.assert_allclose(correction.matrix - np.eye(3), cured, rtol=0.03)


def test_an_old_calibration_is_one_of_another_iron() -> None:
    (case,) = healthy("old")
    correction = case.track.compasses[1].in_force[0].correction
    another = np.linalg.norm(np.asarray(correction.offsets_mgauss) + drawn(case).compass.iron_mgauss)
    assert 29.0 < another < 201.0


def test_raw_readings_are_what_undoing_the_calibration_gives() -> None:
    for case in healthy("two_percent") + healthy("old"):
        raw = case.track.raw_field(1)
        assert np.abs((raw - case.clean_nominal_mgauss).mean(axis=0)).max() < 1.0
        assert (raw - case.clean_nominal_mgauss).std() < 6.0


@pytest.mark.parametrize("averaged", [False, True])
def test_hard_iron_bends_the_yaw_only_where_this_compass_steers(averaged: bool) -> None:
    def bend(steering: str) -> float:
        at = scene(vehicle_of(3, steering=steering, averaged=averaged), seconds=90.0)
        kind = next(kind for kind in CATALOGUE if kind.id == "hard_iron")
        effect = sized(kind, at, 36.0, np.random.default_rng(2))
        assert effect is not None
        bent, straight = recorded(at, effect).track.attitude_rad, recorded(at).track.attitude_rad
        assert bent is not None and straight is not None
        off = (bent.values[:, 2] - straight.values[:, 2] + np.pi) % (2.0 * np.pi) - np.pi
        return float(np.degrees(np.sqrt(np.mean(off**2))))

    assert bend("this_compass") > 1.0
    assert bend("another_compass") == 0.0
    assert bend("gps_antennas") == 0.0


@pytest.mark.parametrize("kind", MOTIONS)
def test_the_attitude_of_a_healthy_vehicle_is_near_the_truth(kind: str) -> None:
    at = scene(vehicle_of(4, kind, "another_compass"), seconds=120.0)
    track = recorded(at).track
    assert track.attitude_rad is not None and track.truth_q is not None
    off = track.attitude_rad.values - angles(quaternion_to_matrix(track.truth_q.values))
    off = np.degrees((off + np.pi) % (2.0 * np.pi) - np.pi)[200:]
    assert np.sqrt(np.mean(off[:, :2] ** 2)) < 1.5
    assert np.sqrt(np.mean(off[:, 2] ** 2)) < 4.0


@pytest.mark.parametrize(
    ("kind", "name"), [(kind, name) for kind, names in MOTIONS.items() for name in names]
)
def test_gyro_and_accelerometer_are_those_of_the_motion(kind: str, name: str) -> None:
    motion = move(kind, name, 60.0, np.random.default_rng(8))
    turned = motion.rotation[:-1] @ rotvec_to_matrix(
        0.01 * 0.5 * (motion.rate_radps[1:] + motion.rate_radps[:-1])
    )
    assert np.abs(turned - motion.rotation[1:]).max() < 2e-3
    way = np.cumsum(motion.velocity_mps, axis=0) * 0.01
    np.testing.assert_allclose(np.diff(way, axis=0), np.diff(motion.position_m, axis=0), atol=2e-3)
    assert np.linalg.norm(motion.acceleration_mps2, axis=1).max() < 12.0


def test_a_case_is_the_same_each_time_and_its_flight_needs_no_baseline() -> None:
    for tier in TIERS:
        one, two, alone = make_case(3, tier), make_case(3, tier), flight(3, tier)
        for other in (two, alone):
            np.testing.assert_array_equal(
                one.track.compasses[1].reported.values, other.track.compasses[1].reported.values
            )
            np.testing.assert_array_equal(one.clean_mgauss, other.clean_mgauss)
            assert one.effects == other.effects
        assert one.baseline is not None and two.baseline is not None and alone.baseline is None
        np.testing.assert_array_equal(
            one.baseline.compasses[1].reported.values, two.baseline.compasses[1].reported.values
        )


def test_a_tier_has_as_many_effects_as_it_says() -> None:
    for seed in (3, 4, 19, 20):  # short ones
        assert [len(flight(seed, tier).effects) for tier in TIERS] == [0, 1, 2, 1]


def test_an_unknown_tier_is_refused() -> None:
    with pytest.raises(ValueError, match="no tier"):
        make_case(1, "triple")  # type: ignore[arg-type]


def test_sizes_lie_between_half_a_floor_and_twelve() -> None:
    for seed in range(12):
        case = flight(seed, "single")
        if case.effects[0][0] != "orientation":
            size = np.sqrt(np.mean((case.clean_mgauss - case.clean_nominal_mgauss) ** 2))
            assert 1.4 <= size <= 38.0


def test_lost_rows_are_missing_in_bursts() -> None:
    at = scene(vehicle_of(7), seconds=200.0)
    complete, holed = recorded(at), recorded(at, lost=0.04)
    rows = len(complete.track.compasses[1].reported)
    kept = len(holed.track.compasses[1].reported)
    assert 0.94 < kept / rows < 0.98
    assert holed.nominal_mgauss.shape == holed.changed_mgauss.shape == (kept, 3)
    gaps = np.diff(holed.track.compasses[1].time_s)
    assert gaps.max() > 4.0 * np.median(gaps)


def test_readings_of_an_autopilot_that_averages_repeat_and_are_late() -> None:
    at = scene(vehicle_of(7, averaged=True))
    values = recorded(at).track.compasses[1].reported.values
    assert 0.5 < np.all(np.diff(values, axis=0) == 0.0, axis=1).mean() < 0.7


def test_the_parameters_say_who_steers() -> None:
    for steering, used in (
        ("this_compass", (1, 0, 1)),
        ("another_compass", (0, 1, 1)),
        ("gps_antennas", (0, 0, 2)),
    ):
        parameters = recorded(scene(vehicle_of(7, steering=steering))).track.parameters
        assert tuple(parameters[n] for n in ("COMPASS_USE", "COMPASS_USE2", "EK3_SRC1_YAW")) == used


def test_the_generator_shares_no_physics_with_simulation_and_diagnosis() -> None:
    for file in Path(package.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            names = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            names += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            for name in names:
                assert not name.startswith("mavcompass") or name.startswith(ALLOWED), (file.name, name)
