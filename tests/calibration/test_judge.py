"""The one judgement: what contradicts, what is turned, what is right already."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from calibration_worlds import FIELD, Iron, body_field, heading_errors, rms, turning_track

from mavcompass.calibration import calibrate_compasses, calibrate_track
from mavcompass.calibration.mounting import find_rotation, turned_compass
from mavcompass.calibration.observation import turn_record
from mavcompass.calibration.result import CalibrationResult
from mavcompass.compass_parameters import sensor_to_body
from mavcompass.correction import FieldCorrection
from mavcompass.earth_field import earth_field_of
from mavcompass.errors import PoorCalibration
from mavcompass.frames import FloatArray, euler_to_matrix, sensor_orientation_matrix, wrap_pi
from mavcompass.heading.deviation import heading_change_rad
from mavcompass.track import InForce, Series, Track

EXTERNAL = {"COMPASS_EXTERNAL": 1.0, "COMPASS_EXTERN2": 1.0, "COMPASS_EXTERN3": 1.0, "COMPASS_ORIENT": 0.0}


@cache
def full_turns() -> tuple[Track, ...]:
    """Record a full turn with each of three irons: one motion, whose roll and pitch are told once."""
    irons = (Iron((80.0, -50.0, 30.0)), Iron((30.0, 55.0, -20.0)), Iron((-40.0, 10.0, 15.0)))
    return tuple(
        turning_track(iron, dwell_s=3.0, turns_deg=(90.0,) * 4, seed=k) for k, iron in enumerate(irons)
    )


def recorded(*turned: FloatArray | None, parameters: dict[str, float] | None = None) -> Track:
    """Record a full turn of compasses that are mounted as set (None) or turned by a rotation (3, 3)."""
    tracks = full_turns()
    compasses = {
        k + 1: replace(tracks[k].compasses[1], instance=k + 1, quantum_mgauss=0.0, truncated=False)
        for k in range(len(turned))
    }
    track = replace(tracks[0], compasses=compasses, parameters=parameters or EXTERNAL, autopilot="ardupilot")
    for k, rotation in enumerate(turned):
        if rotation is not None:
            track = turned_compass(track, k + 1, rotation)
    return track


def test_the_compass_that_two_others_contradict_is_refused_with_what_mends_it() -> None:
    found = calibrate_compasses(recorded(sensor_orientation_matrix(4), None, None), earth=FIELD)
    assert [found[i].accepted for i in (1, 2, 3)] == [False, True, True]
    (reason,) = found[1].reasons
    assert reason.startswith("Compass 1 is mounted turned by 180 degrees") and "COMPASS_ORIENT 4" in reason
    assert "as compasses 2 and 3 show" in reason
    assert {w.witness for w in found[1].evidence if w.contradicts} == {"compass 2", "compass 3"}
    assert found[1].mounting.setting == {"COMPASS_ORIENT": 4.0} and found[1].mounting.angle_deg == 180.0
    assert found[1].to_json()["mounting"]["setting"] == {"COMPASS_ORIENT": 4.0}
    assert found[1].heading_sigma_deg > 100.0


@pytest.fixture(scope="module")
def sound() -> CalibrationResult:
    """What three compasses that are mounted as set tell of the first."""
    return calibrate_track(recorded(None, None, None), earth=FIELD)


@pytest.fixture(scope="module")
def pair() -> CalibrationResult:
    """What two tell of it."""
    return calibrate_track(recorded(None, None), earth=FIELD)


@pytest.mark.parametrize(
    ("autopilot", "number"),
    # Upright, upside down and on its side, by right angles and by half ones; any: below.
    [("ardupilot", 1), ("ardupilot", 26), ("px4", 8)],
)
def test_any_mounting_is_told_and_calibrated_as_it_is(
    number: int, autopilot: str, sound: CalibrationResult
) -> None:
    """The compass is turned by R^-1, so that R mends it."""
    wanted = sensor_orientation_matrix(number)
    parameters = {"CAL_MAG0_ROT": 0.0} if autopilot == "px4" else EXTERNAL
    track = replace(recorded(wanted.T, None, None), autopilot=autopilot, parameters=parameters)
    plain = calibrate_track(track, earth=FIELD)
    mended = plain.mounting.mended
    assert not plain.accepted and mended is not None and mended.accepted, plain.reasons
    # Nothing else that a turned compass seems to have.
    (reason,) = plain.reasons
    assert "is mounted turned by" in reason and "as compasses 2 and 3 show" in reason
    after = {**parameters, **mended.parameters}
    assert sensor_to_body(autopilot, after, 1) == pytest.approx(wanted, abs=1e-6)
    change = heading_change_rad(mended.correction, sound.correction, 216.0, 430.0)
    assert math.degrees(float(np.abs(change).max())) < 0.5


def test_a_free_angle_is_told_to_half_a_degree() -> None:
    parameters = {"CAL_MAG0_ROT": 0.0, "CAL_MAG0_ROLL": 0.0, "CAL_MAG0_PITCH": 0.0, "CAL_MAG0_YAW": 0.0}
    track = replace(
        recorded(euler_to_matrix(0.0, 0.0, math.radians(-33.0)), None, None),
        autopilot="px4",
        parameters=parameters,
    )
    mended = calibrate_track(track, earth=FIELD, turn=True)
    assert mended.accepted and mended.parameters["CAL_MAG0_YAW"] == pytest.approx(33.0, abs=0.5)


@pytest.mark.parametrize("number", [12, 16])
def test_of_two_the_one_whose_gains_are_no_compass_s_is_turned(number: int) -> None:
    """Upside down or on its side a compass shows by itself that it is, and one more tells how."""
    found = calibrate_compasses(recorded(sensor_orientation_matrix(number).T, None), earth=FIELD)
    assert [found[i].accepted for i in (1, 2)] == [False, True]
    assert found[1].mounting.setting == {"COMPASS_ORIENT": float(number)}


def test_no_mounting_mends_an_axis_that_is_the_wrong_way_round() -> None:
    """On the level only the vertical field tells it from upside down."""
    found = calibrate_track(recorded(np.diag([1.0, -1.0, 1.0]), None, None), earth=FIELD)
    assert not found.accepted and found.mounting.turned is None


def test_two_that_contradict_each_other_are_both_refused() -> None:
    found = calibrate_compasses(recorded(sensor_orientation_matrix(2), None), earth=FIELD)
    for result in found.values():
        assert not result.accepted and result.mounting.mended is None
        assert "one of them is mounted turned, or set so, and nothing tells which" in result.reasons[0]


def test_one_alone_is_accepted_and_what_nothing_could_contradict_is_said() -> None:
    result = calibrate_track(recorded(sensor_orientation_matrix(2)), earth=FIELD)
    assert result.accepted and not result.mounting.seen and result.evidence == ()
    assert any(
        "nothing else that was recorded tells it: taken from COMPASS_ORIENT" in w for w in result.warnings
    )
    seen = calibrate_compasses(recorded(None, None), earth=FIELD)[1]
    assert seen.mounting.seen and not any("COMPASS_ORIENT" in warning for warning in seen.warnings)


@pytest.mark.parametrize("off_deg", [1.5, 4.0])
def test_what_the_others_doubt_is_claimed(off_deg: float) -> None:
    """Off by ten of its sigmas from two that agree, it is off by that; from one, as likely as not."""
    turned = euler_to_matrix(0.0, 0.0, math.radians(off_deg))
    free = {**EXTERNAL, "CUST_ROT_ENABLE": 0.0}
    three = calibrate_compasses(recorded(turned, None, None, parameters=free), earth=FIELD)
    assert three[1].heading_sigma_deg == pytest.approx(off_deg, rel=0.25)
    assert three[2].heading_sigma_deg < 0.4 > three[3].heading_sigma_deg
    two = calibrate_compasses(recorded(turned, None, parameters=free), earth=FIELD)
    for result in two.values():
        assert result.heading_sigma_deg == pytest.approx(off_deg / math.sqrt(2.0), rel=0.25)
    assert three[1].accepted is (off_deg < 2.0) and "disagreement" in three[1].heading_budget_deg
    # Two that agree tell its angle, of a few degrees, too; of two nothing tells which is turned.
    if not three[1].accepted:
        assert three[1].mounting.mended is not None and three[1].mounting.mended.accepted
        assert three[1].mounting.setting["CUST_ROT1_YAW"] == pytest.approx(-off_deg, abs=0.5)
    assert all(result.mounting.mended is None for result in two.values())


@pytest.mark.parametrize(("later_s", "steady"), [(0.0, True), (0.08, True), (0.5, False)])
def test_a_compass_may_be_told_a_little_later_than_the_others(later_s: float, steady: bool) -> None:
    """What is read 10 times a second is up to 0.1 s old; half a second is claimed, and bends no iron."""
    irons = (Iron((80.0, -50.0, 30.0)), Iron((30.0, 55.0, -20.0)))
    slow = [
        turning_track(iron, turns_deg=(90.0, 120.0, -60.0, 150.0, 130.0), dwell_s=1.0, turn_s=9.0, seed=k)
        for k, iron in enumerate(irons)
    ]
    late = Series.of(slow[0].compasses[1].time_s + later_s, slow[0].compasses[1].reported.values)
    compasses = {k + 1: replace(slow[k].compasses[1], instance=k + 1) for k in (0, 1)}
    compasses[1] = replace(compasses[1], reported=late)
    found = calibrate_compasses(replace(slow[0], compasses=compasses), "world-field", earth=FIELD)
    assert (found[1].heading_sigma_deg < 0.2) is steady
    assert found[1].heading_budget_deg["disagreement"] < 0.1
    assert rms(heading_errors(found[1].correction, irons[0])) < found[1].heading_sigma_deg < 2.0


def test_the_receivers_yaw_and_the_autopilots_are_witnesses() -> None:
    track = recorded(sensor_orientation_matrix(2).T)
    place = Series.of([0.0, 1.0], [[-35.36, 149.165, 584.0]] * 2)
    earth = earth_field_of(replace(track, place=place))
    assert earth is not None
    record = turn_record(track)
    assert record is not None
    yaw = wrap_pi(record.angle_rad + math.radians(25.0) + earth.declination_rad)
    antenna = replace(track, gps_yaw_rad=Series.of(record.time_s, yaw))
    steered = replace(
        track,
        attitude_rad=Series.of(record.time_s, np.stack([0.0 * yaw, 0.0 * yaw, yaw], axis=1)),
        parameters={**EXTERNAL, "EK3_SRC1_YAW": 1.0, "COMPASS_USE": 0.0, "COMPASS_USE2": 1.0},
    )
    for name, seen in (("gps-yaw", antenna), ("autopilot", steered)):
        result = calibrate_track(seen, earth=earth)
        assert [w.witness for w in result.evidence] == [name]
        assert not result.accepted and result.mounting.setting == {"COMPASS_ORIENT": 2.0}, name
    own = replace(steered, parameters={**EXTERNAL, "EK3_SRC1_YAW": 1.0, "COMPASS_USE": 1.0})
    assert calibrate_track(own, earth=earth).evidence == ()  # the yaw is this compass's


def in_force(track: Track, correction: FieldCorrection) -> Track:
    compass = track.compasses[1]
    reported = Series(compass.time_s, correction.apply(track.raw_field(1)))
    steps = (InForce(-np.inf, correction),)
    return replace(
        track, compasses={**track.compasses, 1: replace(compass, reported=reported, in_force=steps)}
    )


@pytest.mark.parametrize(
    ("off_mgauss", "right"),
    [((0.0, 0.0, 0.0), True), ((0.3, 0.0, 0.0), True), ((8.0, 0.0, 0.0), False), ((0.0, 0.0, 150.0), False)],
)
def test_what_is_right_is_left_alone(
    off_mgauss: tuple[float, float, float], right: bool, pair: CalibrationResult
) -> None:
    """Level or leaning: an offset of Z that is far off is not right."""
    x, y, z = np.add(pair.correction.offsets_mgauss, off_mgauss).tolist()
    again = calibrate_track(
        in_force(recorded(None, None), replace(pair.correction, offsets_mgauss=(x, y, z))), earth=FIELD
    )
    assert again.accepted and again.already_right is right
    assert again.to_json()["already_right"] is right


@pytest.mark.parametrize(
    ("autopilot", "parameters", "right"),
    [
        ("ardupilot", {}, False),  # for which offsets of zero are no calibration
        ("px4", {"CAL_MAG0_ID": 197388.0}, True),  # whose id is stored by a calibration
        ("px4", {"CAL_MAG0_ID": 0.0}, False),
    ],
)
def test_offsets_of_zero_may_be_a_calibration(
    autopilot: str, parameters: dict[str, float], right: bool
) -> None:
    track = turning_track(Iron((0.0, 0.0, 0.0)), turns_deg=(90.0,) * 4)
    track = replace(track, autopilot=autopilot, parameters=parameters)
    result = calibrate_track(track, earth=FIELD)
    assert result.accepted and result.already_right is right


# --- Which way a compass is mounted, by what it reads and what it should: equation (O1)


LEVEL = np.linspace(0.0, 6.2, 400)


def tumbling() -> FloatArray:
    rng = np.random.default_rng(4)
    q = rng.normal(size=(1500, 3))
    return np.asarray(q / np.linalg.norm(q, axis=1, keepdims=True) * 480.0)


@pytest.mark.parametrize("number", [0, 2, 4, 8, 12, 16, 25, 38])
@pytest.mark.parametrize("motion", ["level", "tumbling"])
def test_the_rotation_is_found_beside_hard_iron_and_a_gain(number: int, motion: str) -> None:
    field = body_field(LEVEL) if motion == "level" else tumbling()
    turned = sensor_orientation_matrix(number)
    noise = np.random.default_rng(2).normal(0.0, 3.0, field.shape)
    raw = 0.8 * (field + noise) @ turned + (40.0, -20.0, 90.0)
    found = find_rotation(raw, field)
    assert found == pytest.approx(turned, abs=0.03)


def test_a_free_angle_is_found_to_half_a_degree() -> None:
    turned = euler_to_matrix(*np.radians([10.0, -20.0, 33.0]))
    found = find_rotation(tumbling() @ turned, tumbling())
    assert np.degrees(np.linalg.norm(found - turned) / math.sqrt(2.0)) < 0.5


def test_a_short_turn_tells_nothing_and_unknown_rows_are_passed_over() -> None:
    with pytest.raises(PoorCalibration, match="turned too little"):
        find_rotation(body_field(LEVEL[:20]), body_field(LEVEL[:20]))
    expected = tumbling()
    expected[::2] = np.nan
    assert find_rotation(tumbling(), expected) == pytest.approx(np.eye(3), abs=1e-6)
    with pytest.raises(PoorCalibration):
        find_rotation(tumbling(), np.full((1500, 3), np.nan))
