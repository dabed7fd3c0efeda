"""What a write would do to an ArduPilot vehicle, and what speaks against it."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from parameter_vehicle import ardupilot_parameters

from mavcompass.compass_parameters import ardupilot_correction
from mavcompass.correction import FieldCorrection
from mavcompass.frames import rotation_of
from mavcompass.procedure.dialect import ParameterPlan
from mavcompass.vehicle.dialects import make_dialect

DIALECT = make_dialect("ardupilot")
GOOD = FieldCorrection((120.0, -80.0, 40.0), (1.1, 0.9, 1.0), (0.02, -0.01, 0.005), 1.02)


def plan(correction: FieldCorrection = GOOD, instance: int = 1, **parameters: float) -> ParameterPlan:
    return DIALECT.plan(ardupilot_parameters(**parameters), {instance: correction})


def after(plan: ParameterPlan, **parameters: float) -> dict[str, float]:
    return ardupilot_parameters(**parameters) | {c.name: c.new for c in plan.changes}


finite_corrections = st.builds(
    FieldCorrection,
    st.tuples(*[st.floats(-900, 900)] * 3),
    st.tuples(*[st.floats(0.6, 1.6)] * 3),
    st.tuples(*[st.floats(-0.2, 0.2)] * 3),
    st.floats(0.7, 1.45),
    st.tuples(*[st.floats(-20, 20)] * 3),
    st.sampled_from(["none", "throttle", "current"]),
)


@given(finite_corrections, st.integers(1, 2))
def test_what_is_planned_is_what_will_be_in_force(correction: FieldCorrection, instance: int) -> None:
    planned = DIALECT.plan(ardupilot_parameters(), {instance: correction})
    assert not planned.refusals
    new = ardupilot_correction(after(planned), instance)
    assert new.offsets_mgauss == pytest.approx(correction.offsets_mgauss, rel=1e-6, abs=0.0101)
    assert new.matrix == pytest.approx(correction.matrix, rel=1e-6, abs=1e-8)
    if correction.motor_source != "none":
        assert new.motor_mgauss == pytest.approx(correction.motor_mgauss, rel=1e-6)
        assert new.motor_source == correction.motor_source


@given(finite_corrections, st.integers(1, 2))
def test_no_other_compass_is_ever_in_the_changes(correction: FieldCorrection, instance: int) -> None:
    planned = DIALECT.plan(ardupilot_parameters(), {instance: correction})
    assert {DIALECT.instance_of(c.name) for c in planned.changes} <= {instance, None}
    assert {c.name for c in planned.changes if DIALECT.instance_of(c.name) is None} <= {"COMPASS_MOTCT"}


@given(finite_corrections)
def test_planning_twice_changes_nothing_the_second_time(correction: FieldCorrection) -> None:
    values = after(DIALECT.plan(ardupilot_parameters(), {1: correction}))
    assert DIALECT.plan(values, {1: correction}).changes == ()


def test_what_has_the_same_effect_is_left_alone() -> None:
    no_matrix = {f"COMPASS_DIA_{axis}": 0.0 for axis in "XYZ"} | {"COMPASS_ODI_X": 0.3, "COMPASS_SCALE": 0.0}
    planned = plan(FieldCorrection((5.0, 13.0, -18.0)), **no_matrix)
    assert planned.changes == () and not planned.refusals


def test_leaving_no_matrix_writes_all_of_it_where_it_was_disabled() -> None:
    no_matrix = {f"COMPASS_DIA_{axis}": 0.0 for axis in "XYZ"} | {"COMPASS_ODI_X": 0.3}
    planned = plan(FieldCorrection((5.0, 13.0, -18.0), (1.1, 1.0, 1.0)), **no_matrix)
    assert {c.name for c in planned.changes} == {"COMPASS_ODI_X", *(f"COMPASS_DIA_{a}" for a in "XYZ")}


def test_offsets_come_last_and_single_values_are_listed_once() -> None:
    names = [c.name for c in plan().changes]
    # The estimator forgets what it has learnt of a compass when the offsets change: then all else is there.
    assert names[-3:] == ["COMPASS_OFS_X", "COMPASS_OFS_Y", "COMPASS_OFS_Z"]
    assert len(set(names)) == len(names)


def test_offsets_are_never_exactly_zero() -> None:
    planned = plan(FieldCorrection((0.0, 0.0, 0.0)))
    new = after(planned)
    assert not planned.refusals
    assert 0.0 < new["COMPASS_OFS_X"] < 0.1 and new["COMPASS_OFS_Y"] == 0.0


def test_zero_on_one_axis_is_fine() -> None:
    assert after(plan(FieldCorrection((0.0, 20.0, 0.0))))["COMPASS_OFS_X"] == 0.0


def test_a_first_calibration_wants_the_device_id_stored() -> None:
    zero = {f"COMPASS_OFS_{axis}": 0.0 for axis in "XYZ"}
    assert plan(**zero).commit_instances == (1,)
    assert plan().commit_instances == ()


@pytest.mark.parametrize(
    ("correction", "said"),
    [
        (replace(GOOD, offsets_mgauss=(1500.0, 1100.0, 0.0)), r"1860 mGauss long and the vehicle takes 1800"),
        (replace(GOOD, diagonals=(0.1, 1.0, 1.0)), r"diagonal of 0\.1 is outside"),
        (replace(GOOD, diagonals=(1.0, -1.0, 1.0)), r"diagonal of -1 is outside"),
        (replace(GOOD, off_diagonals=(1.2, 0.0, 0.0)), r"off-diagonal of 1\.2"),
        (replace(GOOD, off_diagonals=(0.9, 0.9, -0.9)), r"matrix is not positive"),
        (replace(GOOD, scale=1.6), r"ignores a scale of 1\.6"),
        (replace(GOOD, scale=0.6), r"ignores a scale of 0\.6"),
        (replace(GOOD, scale=0.0), r"scale of zero"),
        (replace(GOOD, offsets_mgauss=(math.nan, 0.0, 0.0)), r"cannot be (nan|inf)"),
        (replace(GOOD, off_diagonals=(math.inf, 0.0, 0.0)), r"cannot be (nan|inf)"),
        (replace(GOOD, motor_mgauss=(2000.0, 0.0, 0.0), motor_source="current"), r"motor term of 2000"),
    ],
)
def test_what_the_firmware_would_not_use_is_refused(correction: FieldCorrection, said: str) -> None:
    (refusal,) = plan(correction).refusals
    assert re.search(said, refusal), refusal


def test_the_firmware_applies_a_scale_at_its_limits() -> None:
    limits = DIALECT.rules.scale
    assert limits is not None
    for limit, beyond in zip(limits, (-1e-3, 1e-3), strict=True):
        assert not plan(replace(GOOD, scale=limit)).refusals
        assert plan(replace(GOOD, scale=limit + beyond)).refusals


def test_the_vehicles_own_offset_limit_counts() -> None:
    big = replace(GOOD, offsets_mgauss=(900.0, 0.0, 0.0))
    assert not plan(big).refusals
    assert "takes 850" in plan(big, COMPASS_OFFS_MAX=850.0).refusals[0]
    assert "beyond the usual" in " ".join(plan(big).remarks)


@pytest.mark.parametrize("instance", [3, 4])
def test_a_compass_that_is_not_there_is_refused(instance: int) -> None:
    (refusal,) = plan(instance=instance).refusals
    assert refusal.startswith(f"Compass {instance} is not there")


def test_in_flight_learning_is_refused_and_other_learning_is_told() -> None:
    assert "COMPASS_LEARN is 3" in plan(COMPASS_LEARN=3.0).refusals[0]
    learning = plan(COMPASS_LEARN=2.0)
    assert not learning.refusals and "COMPASS_LEARN is 2" in " ".join(learning.remarks)


def test_a_compass_switched_off_is_refused_and_an_unused_one_is_told() -> None:
    assert "switched off" in plan(COMPASS_ENABLE=0.0).refusals[0]
    assert "COMPASS_USE2 is 0" in " ".join(plan(instance=2, COMPASS_USE2=0.0).remarks)


def test_a_declination_by_hand_is_told() -> None:
    remarks = " ".join(plan(COMPASS_AUTODEC=0.0).remarks)
    assert "declination of 12.8 deg" in remarks
    assert "declination" not in " ".join(plan().remarks)


def test_a_change_of_priority_before_the_next_start_is_told() -> None:
    assert "change places" in " ".join(plan(COMPASS_PRIO1_ID=131874.0).remarks)


def test_firmware_without_a_scale_gets_it_in_the_matrix() -> None:
    old = ardupilot_parameters()
    for name in ("COMPASS_SCALE", "COMPASS_SCALE2", "COMPASS_SCALE3"):
        del old[name]
    planned = DIALECT.plan(old, {1: GOOD})
    assert not planned.refusals
    new = ardupilot_correction(old | {c.name: c.new for c in planned.changes}, 1)
    assert new.matrix == pytest.approx(GOOD.matrix, rel=1e-6)


def test_the_newer_spelling_is_written_as_it_was_read() -> None:
    newer = {"COMPASS_ENABLE": 1.0}
    for stem, value in (("OFS", 3.0), ("DIA", 1.0), ("ODI", 0.0), ("MOT", 0.0)):
        newer |= {f"COMPASS{n}_{stem}_{axis}": value for n in (1, 2) for axis in "XYZ"}
    newer |= {f"COMPASS{n}_SCALE": 1.0 for n in (1, 2)}
    planned = DIALECT.plan(newer, {2: GOOD})
    assert not planned.refusals
    assert {c.name[:9] for c in planned.changes} == {"COMPASS2_"}


def test_the_meaning_of_another_compasss_motor_terms_is_not_changed() -> None:
    motor = replace(GOOD, motor_mgauss=(-5.0, 0.0, 0.0), motor_source="current")
    assert not plan(motor).refusals
    (refusal,) = plan(motor, COMPASS_MOT2_X=3.0, COMPASS_MOTCT=1.0).refusals
    assert "compass 2's motor terms" in refusal


def test_the_motor_term_in_force_is_left_by_a_correction_without_one() -> None:
    planned = plan(COMPASS_MOT_X=4.0, COMPASS_MOTCT=2.0)
    assert not [c for c in planned.changes if "MOT" in c.name]


def test_single_values_are_judged_by_what_the_vehicle_would_hold() -> None:
    held = ardupilot_parameters(COMPASS_OFS_Y=1700.0)
    assert DIALECT.plan_values(held, {"COMPASS_OFS_X": 800.0}).refusals
    unchecked = DIALECT.plan_values(held, {"COMPASS_OFS_X": 800.0}, checked=False)
    assert not unchecked.refusals and "long and the vehicle takes" in unchecked.remarks[0]
    zero = {f"COMPASS_OFS_{axis}": 0.0 for axis in "XYZ"}
    assert "exactly zero" in DIALECT.plan_values(ardupilot_parameters(), zero).refusals[0]
    assert "ignores a scale" in DIALECT.plan_values(held, {"COMPASS_SCALE2": 1.7}).refusals[0]


def test_device_ids_and_unknown_names_are_not_written() -> None:
    held = ardupilot_parameters()
    for name in ("COMPASS_DEV_ID", "COMPASS_DEV_ID2", "COMPASS_PRIO1_ID"):
        assert "firmware's own" in DIALECT.plan_values(held, {name: 1.0}, checked=False).refusals[0]
    assert "no parameter COMPASS_NONSENSE" in DIALECT.plan_values(held, {"COMPASS_NONSENSE": 1.0}).refusals[0]


def test_a_restart_is_asked_for_where_it_is_needed() -> None:
    remarks = DIALECT.plan_values(ardupilot_parameters(), {"COMPASS_ENABLE": 0.0}).remarks
    assert "COMPASS_ENABLE takes effect after a restart of the autopilot." in remarks


def test_the_pieces_of_a_vehicle_are_told_apart() -> None:
    assert DIALECT.instances(ardupilot_parameters()) == (1, 2)
    assert DIALECT.instances({"COMPASS_OFS_X": 1.0}) == (1,)
    names = {"COMPASS_SCALE": 1, "COMPASS_USE3": 3, "COMPASS_EXTERN2": 2, "COMPASS_EXTERNAL": 1}
    names |= {"COMPASS_DEV_ID4": None, "COMPASS_PRIO1_ID": None, "COMPASS_OFFS_MAX": None}
    assert {name: DIALECT.instance_of(name) for name in names} == names


def test_a_turned_compass_is_set_before_its_correction_and_undone_after_it() -> None:
    held = ardupilot_parameters(COMPASS_EXTERNAL=1.0, COMPASS_ORIENT=2.0)
    planned = DIALECT.plan(held, {1: GOOD}, {1: rotation_of((0.0, 0.0, 90.0))})
    assert not planned.refusals and planned.changes[0].name == "COMPASS_ORIENT"
    assert (planned.changes[0].old, planned.changes[0].new) == (2.0, 4.0)
    assert "restart" not in " ".join(planned.remarks[:-1])


def test_two_compasses_turned_freely_get_a_set_of_angles_each_and_a_third_none() -> None:
    external = dict.fromkeys(("COMPASS_EXTERNAL", "COMPASS_EXTERN2", "COMPASS_EXTERN3"), 1.0)
    held = ardupilot_parameters(**external, COMPASS_DEV_ID3=7.0)
    turned = {i: rotation_of((0.0, 10.0 * i, 5.0)) for i in (1, 2, 3)}
    planned = DIALECT.plan(held, dict.fromkeys((1, 2), GOOD), turned)
    new = {c.name: c.new for c in planned.changes}
    assert (new["COMPASS_ORIENT"], new["COMPASS_ORIENT2"]) == (101.0, 102.0) and not planned.refusals
    assert new["CUST_ROT1_PITCH"] == pytest.approx(10.0) and new["CUST_ROT2_PITCH"] == pytest.approx(20.0)
    assert any("CUST_ROT1_PITCH" in r and "take effect after a restart" in r for r in planned.remarks)
    (refusal,) = DIALECT.plan(held, dict.fromkeys((1, 2, 3), GOOD), turned).refusals
    assert "Compass 3" in refusal and "no free angles left" in refusal


def test_an_internal_compass_cannot_be_turned_alone() -> None:
    (refusal,) = DIALECT.plan(ardupilot_parameters(), {1: GOOD}, {1: rotation_of((0, 0, 90))}).refusals
    assert "COMPASS_ORIENT is not for it" in refusal and "AHRS_ORIENTATION" in refusal


def test_an_orientation_by_hand_is_judged_by_what_it_would_do() -> None:
    external = ardupilot_parameters(COMPASS_EXTERNAL=1.0)
    (refusal,) = DIALECT.plan_values(external, {"COMPASS_ORIENT": 99.0}).refusals
    assert "no rotation that this firmware knows" in refusal
    assert "calibrate it" in DIALECT.plan_values(external, {"COMPASS_ORIENT": 4.0}).remarks[0]
    internal = DIALECT.plan_values(ardupilot_parameters(), {"COMPASS_ORIENT": 4.0})
    assert "does nothing" in internal.remarks[0] and not internal.refusals
