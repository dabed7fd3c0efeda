"""The second generator's cases: a healthy vehicle reads the field, each effect changes what it should."""

from __future__ import annotations

import ast
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import mavcompass.gap.vehicles as package
from mavcompass.gap.vehicles import Tier, VehicleCase, make_case
from mavcompass.gap.vehicles.cases import CATALOGUE, OUTSIDE
from mavcompass.gap.vehicles.draw import Vehicle, draw_vehicle
from mavcompass.gap.vehicles.effects.kind import Kind, sized
from mavcompass.gap.vehicles.loads import loads_of
from mavcompass.gap.vehicles.motion import MOTIONS, move
from mavcompass.gap.vehicles.record import Recording, record
from mavcompass.gap.vehicles.rotations import (
    Array,
    angles,
    from_angles,
    from_quaternions,
    from_vector,
    quaternions,
    to_body,
)
from mavcompass.gap.vehicles.scene import Effect, Scene, ambient, readings, scene_of, stream
from mavcompass.simulation.effects import catalogue
from mavcompass.track import Track

TIERS: tuple[Tier, ...] = ("none", "single", "pair", "outside")
ALLOWED = ("mavcompass.gap.vehicles", "mavcompass.track", "mavcompass.correction", "mavcompass.earth_field")


def vehicle_of(
    seed: int, kind: str = "rover", steering: str = "this_compass", averaged: bool = False
) -> Vehicle:
    vehicle = draw_vehicle(np.random.default_rng(seed), kind, averaged, True)
    return replace(vehicle, steering=steering, rate_hz=25.0)


def scene(vehicle: Vehicle, name: str = "figure_eight", seconds: float = 70.0, seed: int = 5) -> Scene:
    rng = np.random.default_rng(seed)
    motion = move(vehicle.kind, name, seconds, rng)
    loads = loads_of(vehicle.kind, motion, 12.0, rng)
    return scene_of(vehicle, motion, loads, vehicle.site.field_mgauss, rng)


def recorded(at: Scene, *effects: Effect, lost: float = 0.0) -> Recording:
    return record(at, at.vehicle.site, effects, lost, np.random.default_rng(9))


def field_in_body(track: Track, field_ned: object) -> Array:
    assert track.truth_q is not None
    return to_body(from_quaternions(track.truth_q.values), np.asarray(field_ned))


@cache
def healthy(cure: str, count: int = 1) -> list[VehicleCase]:
    """Find healthy cases whose readings are neither averaged nor cut, where the baseline was flown."""
    found = []
    for seed in range(200):
        case = make_case(seed, "none", baseline=False)
        d = case.description
        plain = not d["averaged"] and not d["whole"] and not np.any(d["current_field_mgauss_per_a"])
        if d["cure"] == cure and plain:
            found.append(case)
        if len(found) == count:
            return found
    raise AssertionError(f"no healthy case is cured {cure}")


def test_a_healthy_compass_reads_the_field_to_its_stated_noise() -> None:
    (case,) = healthy("exact")
    expected = field_in_body(case.clean, case.description["field_ned_mgauss"])
    np.testing.assert_allclose(case.clean.compasses[1].reported.values, expected, atol=1e-6)
    off = case.track.compasses[1].reported.values - field_in_body(
        case.track, case.description["field_ned_mgauss"]
    )
    correction = case.track.compasses[1].in_force[0].correction.matrix
    stated = np.sqrt(
        np.diag(correction @ np.diag(np.square(case.description["noise_mgauss"])) @ correction.T)
    )
    assert np.all(off.std(axis=0) > 0.9 * stated)
    assert np.all(off.std(axis=0) < 1.3 * stated + 0.5)
    np.testing.assert_array_equal(case.clean_mgauss, case.clean_nominal_mgauss)


def test_two_percent_of_what_the_calibration_cures_stay() -> None:
    (case,) = healthy("two_percent")
    correction = case.track.compasses[1].in_force[0].correction
    left = np.abs(np.asarray(correction.offsets_mgauss) / case.description["iron_mgauss"] + 1.0)
    assert np.all((left > 0.01) & (left < 0.03))
    cured = np.linalg.inv(np.asarray(case.description["matrix"])) - np.eye(3)
    np.testing.assert_allclose(correction.matrix - np.eye(3), cured, rtol=0.03)


def test_an_old_calibration_is_one_of_another_iron() -> None:
    (case,) = healthy("old")
    correction = case.track.compasses[1].in_force[0].correction
    another = np.linalg.norm(np.asarray(correction.offsets_mgauss) + case.description["iron_mgauss"])
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
    off = track.attitude_rad.values - angles(from_quaternions(track.truth_q.values))
    off = np.degrees((off + np.pi) % (2.0 * np.pi) - np.pi)[200:]
    assert np.sqrt(np.mean(off[:, :2] ** 2)) < 1.5
    assert np.sqrt(np.mean(off[:, 2] ** 2)) < 4.0


@pytest.mark.parametrize(
    ("kind", "name"), [(kind, name) for kind, names in MOTIONS.items() for name in names]
)
def test_gyro_and_accelerometer_are_those_of_the_motion(kind: str, name: str) -> None:
    motion = move(kind, name, 60.0, np.random.default_rng(8))
    turned = motion.rotation[:-1] @ from_vector(0.01 * 0.5 * (motion.rate_radps[1:] + motion.rate_radps[:-1]))
    assert np.abs(turned - motion.rotation[1:]).max() < 2e-3
    way = np.cumsum(motion.velocity_mps, axis=0) * 0.01
    np.testing.assert_allclose(np.diff(way, axis=0), np.diff(motion.position_m, axis=0), atol=2e-3)
    assert np.linalg.norm(motion.acceleration_mps2, axis=1).max() < 12.0


def test_a_rotation_goes_there_and_back() -> None:
    given = np.random.default_rng(1).uniform(-1.4, 1.4, (50, 3))
    rotation = from_angles(*given.T)
    np.testing.assert_allclose(angles(rotation), given, atol=1e-12)
    np.testing.assert_allclose(from_quaternions(quaternions(rotation)), rotation, atol=1e-12)
    # Nose to the east, right wing down by 90 degrees: the body's right axis points down.
    one = from_angles(np.array([np.pi / 2]), np.zeros(1), np.array([np.pi / 2]))[0]
    np.testing.assert_allclose(one @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(one @ [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], atol=1e-12)


def straightness(values: Array, against: Array) -> float:
    """Return how far columns (N, 3) are from a linear map of columns (N, k), rms over rms."""
    fitted = against @ np.linalg.lstsq(against, values, rcond=None)[0]
    return float(np.sqrt(np.mean((values - fitted) ** 2) / np.mean(values**2)))


def turns_keep_length(at: Scene, effect: Effect, change: Array) -> bool:
    raw = readings(at, at.plain_mgauss)
    return bool(np.allclose(np.linalg.norm(raw + change, axis=1), np.linalg.norm(raw, axis=1)))


def row_times(at: Scene) -> Array:
    return at.start_s + at.reading_s


def latest(at: Scene, values: Array) -> Array:
    columns = values.reshape(len(values), -1)
    return columns[np.minimum((at.reading_s / 0.01).astype(int), len(values) - 1)]


def in_the_world(at: Scene, change: Array) -> Array:
    rotation = latest(at, at.motion.rotation).reshape(-1, 3, 3)
    return np.asarray(np.einsum("nij,nj->ni", rotation, change @ np.linalg.inv(at.compass.matrix.T)))


def step_is_there_from_its_moment(at: Scene, effect: Effect, change: Array) -> bool:
    time, there = row_times(at), np.linalg.norm(change, axis=1) > 0.0
    wanted = (time >= effect.parameters["on_s"]) & (time < effect.parameters.get("off_s", np.inf))
    return bool((there != wanted).mean() < 0.005)


def strongest_near_the_magnet(at: Scene, effect: Effect, change: Array) -> bool:
    magnet = np.array([effect.parameters[n] for n in ("north_m", "east_m", "down_m")])
    apart = np.linalg.norm(latest(at, at.motion.position_m) - magnet, axis=1)
    size = np.linalg.norm(change, axis=1)
    return bool(
        apart[np.argmax(size)] < np.quantile(apart, 0.1) and size[np.argmax(apart)] < 0.3 * size.max()
    )


def line_in_the_spectrum(at: Scene, effect: Effect, change: Array) -> bool:
    phase = 2.0 * np.pi * effect.parameters["frequency_hz"] * row_times(at)
    return straightness(change, np.column_stack([np.sin(phase), np.cos(phase)])) < 0.15


Check = Callable[[Scene, Effect, Array], bool]
RAW: Callable[[Scene], Array] = lambda at: readings(at, at.plain_mgauss)  # noqa: E731
CHECKS: dict[str, Check] = {
    "hard_iron": lambda at, e, c: bool(np.ptp(c, axis=0).max() < 1e-9),
    "hard_iron_step": step_is_there_from_its_moment,
    "soft_iron": lambda at, e, c: straightness(c, latest(at, ambient(at))) < 1e-9,
    "axis_scale": lambda at, e, c: np.allclose(c, RAW(at) * [e.parameters[a] for a in "xyz"]),
    "non_orthogonality": lambda at, e, c: np.abs(c[:, 0]).max() < 1e-9 and straightness(c, RAW(at)) < 1e-9,
    "misalignment": turns_keep_length,
    "orientation": turns_keep_length,
    "motor_current": lambda at, e, c: straightness(c, latest(at, at.loads.current_a)) < 1e-9,
    "per_motor": lambda at, e, c: straightness(c, latest(at, at.loads.motors)) < 1e-9,
    "relay_field": lambda at, e, c: len(np.unique(c.round(6), axis=0)) == 2,
    "temperature_bias": lambda at, e, c: (
        straightness(c, latest(at, at.loads.temperature_degc - e.parameters["reference_degc"])) < 1e-9
    ),
    "temperature_sensitivity": lambda at, e, c: (
        straightness(c, RAW(at) * latest(at, at.loads.temperature_degc - e.parameters["reference_degc"]))
        < 1e-9
    ),
    "clipping": lambda at, e, c: np.abs(RAW(at) + c).max() <= e.parameters["limit_mgauss"],
    "transport_lag": lambda at, e, c: (
        straightness(c, -e.parameters["lag_s"] * latest(at, np.gradient(at.plain_mgauss, 0.01, axis=0))) < 0.4
    ),
    "low_pass": lambda at, e, c: np.abs(RAW(at) + c).max() <= np.abs(at.plain_mgauss).max(),
    "spatial_dipole": strongest_near_the_magnet,
    "field_gradient": lambda at, e, c: (
        straightness(in_the_world(at, c), latest(at, at.motion.position_m)) < 1e-9
    ),
    "eddy_current": lambda at, e, c: np.allclose(
        c @ np.linalg.inv(at.compass.matrix.T),
        -latest(at, np.gradient(ambient(at), 0.01, axis=0)) * [e.parameters[a] for a in "xyz"],
    ),
    "hysteresis": lambda at, e, c: (
        np.abs(c @ np.linalg.inv(at.compass.matrix.T)).max() <= abs(e.parameters["remanence_mgauss"]) * 1.5
    ),
    "cross_axis": lambda at, e, c: straightness(c[:, :1], RAW(at)[:, :1] * RAW(at)[:, 1:]) < 1e-9,
    "set_reset_offset": lambda at, e, c: np.allclose(c[1:], -c[:-1]),
    "ac_interference": line_in_the_spectrum,
    "noise_excess": lambda at, e, c: abs(np.corrcoef(c[1:, 0], c[:-1, 0])[0, 1]) < 0.1,
    "stale_samples": lambda at, e, c: (
        abs(np.all(np.diff(RAW(at) + c, axis=0) == 0.0, axis=1).mean() - e.parameters["fraction"]) < 0.06
    ),
    "quantisation": lambda at, e, c: np.allclose(
        (RAW(at) + c) / e.parameters["step_mgauss"], np.round((RAW(at) + c) / e.parameters["step_mgauss"])
    ),
}


@pytest.mark.parametrize("kind", CATALOGUE, ids=lambda kind: kind.id)
def test_an_effect_changes_what_its_name_says(kind: Kind) -> None:
    at = scene(vehicle_of(6), seconds=70.0)
    effect = sized(kind, at, 3.0, np.random.default_rng(11))
    assert effect is not None
    change = readings(at, stream(at, [effect]), [effect]) - readings(at, at.plain_mgauss)
    if kind.sized:
        assert np.sqrt(np.mean(change**2)) == pytest.approx(3.0, rel=0.05)
    assert CHECKS[kind.id](at, effect, change)
    label = {parameter.name: parameter for parameter in catalogue()[kind.id].parameters}
    for name, value in effect.parameters.items():
        assert label[name].low <= value <= label[name].high


@pytest.mark.parametrize("kind", OUTSIDE, ids=lambda kind: kind.id)
def test_what_is_outside_the_catalogue_changes_the_readings_as_much_as_wanted(kind: Kind) -> None:
    at = scene(vehicle_of(6, "copter" if "altitude" in kind.needs else "rover"), seconds=70.0)
    effect = sized(kind, at, 6.0, np.random.default_rng(12))
    assert effect is not None
    assert kind.id not in catalogue()
    change = readings(at, stream(at, [effect]), [effect]) - readings(at, at.plain_mgauss)
    assert 1.5 <= np.sqrt(np.mean(change**2)) <= 6.5


def test_a_case_is_the_same_each_time_and_its_flight_needs_no_baseline() -> None:
    for tier in TIERS:
        one, two, alone = make_case(17, tier), make_case(17, tier), make_case(17, tier, baseline=False)
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
    for seed in range(8):
        assert [len(make_case(seed, tier, baseline=False).effects) for tier in TIERS] == [0, 1, 2, 1]


def test_an_unknown_tier_is_refused() -> None:
    with pytest.raises(ValueError, match="no tier"):
        make_case(1, "triple")  # type: ignore[arg-type]


def test_sizes_lie_between_half_a_floor_and_twelve() -> None:
    for seed in range(20):
        case = make_case(seed, "single", baseline=False)
        if case.effects[0][0] != "orientation":
            (size,) = case.description["rms_change_of_each_mgauss"]  # type: ignore[misc]
            assert 1.45 <= size <= 37.5


def test_lost_rows_are_missing_in_bursts_and_the_clean_flight_is_whole() -> None:
    at = scene(vehicle_of(7), seconds=200.0)
    complete, holed = recorded(at), recorded(at, lost=0.04)
    rows = len(complete.track.compasses[1].reported)
    kept = len(holed.track.compasses[1].reported)
    assert 0.94 < kept / rows < 0.98
    assert holed.nominal_mgauss.shape == holed.changed_mgauss.shape == (kept, 3)
    assert len(holed.clean.compasses[1].reported) == rows
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
