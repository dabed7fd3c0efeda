"""What a write would do to a PX4 vehicle: other sign, other unit, the sensor's own axes."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from parameter_vehicle import px4_parameters

from mavcompass.correction import FieldCorrection
from mavcompass.frames import rotation_of, sensor_orientation_matrix
from mavcompass.vehicle.dialects import make_dialect

DIALECT = make_dialect("px4")
GOOD = FieldCorrection((120.0, -80.0, 40.0), (1.1, 0.9, 1.0), (0.02, -0.01, 0.005), 1.02)

finite_corrections = st.builds(
    FieldCorrection,
    st.tuples(*[st.floats(-700, 700)] * 3),
    st.tuples(*[st.floats(0.6, 1.6)] * 3),
    st.tuples(*[st.floats(-0.2, 0.2)] * 3),
    st.floats(0.7, 1.4),
)


def test_offsets_are_gauss_with_the_other_sign() -> None:
    planned = DIALECT.plan(px4_parameters(), {1: GOOD})
    new = {c.name: c.new for c in planned.changes}
    assert (new["CAL_MAG0_XOFF"], new["CAL_MAG0_YOFF"], new["CAL_MAG0_ZOFF"]) == (-0.12, 0.08, -0.04)
    assert new["CAL_MAG0_XSCALE"] == pytest.approx(1.1 * 1.02)


@given(finite_corrections, st.integers(1, 2), st.integers(-1, 47), st.integers(0, 7))
def test_what_is_planned_is_what_will_be_in_force(
    correction: FieldCorrection, instance: int, mounting: int, board: int
) -> None:
    rotations = {f"CAL_MAG{instance - 1}_ROT": float(mounting), "SENS_BOARD_ROT": float(board)}
    held = px4_parameters(**rotations)
    planned = DIALECT.plan(held, {instance: correction})
    assert not [r for r in planned.refusals if "outside" not in r]
    new = DIALECT.correction(held | {c.name: c.new for c in planned.changes}, instance)
    assert new.offsets_mgauss == pytest.approx(correction.offsets_mgauss, rel=1e-6, abs=2e-3)
    assert new.matrix == pytest.approx(correction.matrix, rel=1e-6, abs=3e-6)
    assert {DIALECT.instance_of(c.name) for c in planned.changes} <= {instance}


@given(finite_corrections, st.sampled_from([-1, 0, 1, 4, 12, 25]))
def test_the_correction_in_force_changes_nothing_when_planned_again(
    correction: FieldCorrection, mounting: int
) -> None:
    held = px4_parameters(CAL_MAG0_ROT=float(mounting))
    held |= {c.name: c.new for c in DIALECT.plan(held, {1: correction}).changes}
    assert DIALECT.plan(held, {1: DIALECT.correction(held, 1)}).changes == ()


@given(finite_corrections, finite_corrections)
def test_any_correction_may_follow_any_other_its_opposite_included(
    before: FieldCorrection, correction: FieldCorrection
) -> None:
    x, y, z = before.offsets_mgauss
    for wanted in (correction, replace(before, offsets_mgauss=(-x, -y, -z))):
        held = px4_parameters()
        held |= {c.name: c.new for c in DIALECT.plan(held, {1: before}).changes}
        held |= {c.name: c.new for c in DIALECT.plan(held, {1: wanted}).changes}
        new = DIALECT.correction(held, 1)
        assert new.offsets_mgauss == pytest.approx(wanted.offsets_mgauss, rel=1e-6, abs=2e-3)
        assert new.matrix == pytest.approx(wanted.matrix, rel=1e-6, abs=3e-6)


def test_an_internal_compass_turns_with_the_board() -> None:
    raw_body = sensor_orientation_matrix(2) @ np.array([0.1, 0.2, 0.3]) * 1000.0
    held = px4_parameters(SENS_BOARD_ROT=2.0, CAL_MAG0_XOFF=0.1, CAL_MAG0_YOFF=0.2, CAL_MAG0_ZOFF=0.3)
    assert DIALECT.correction(held, 1).apply(raw_body) == pytest.approx([0.0, 0.0, 0.0], abs=1e-9)


def test_a_slot_without_a_device_id_is_refused() -> None:
    assert DIALECT.instances(px4_parameters()) == (1, 2)
    (refusal,) = DIALECT.plan(px4_parameters(), {3: GOOD}).refusals
    assert "CAL_MAG2_ID holds no device id" in refusal


def test_what_px4_would_not_use_is_refused() -> None:
    for bad in (
        replace(GOOD, offsets_mgauss=(1300.0, 400.0, 0.0)),
        replace(GOOD, diagonals=(3.5, 1.0, 1.0)),
        replace(GOOD, offsets_mgauss=(math.nan, 0.0, 0.0)),
        replace(GOOD, off_diagonals=(0.9, 0.9, -0.9)),
    ):
        assert DIALECT.plan(px4_parameters(), {1: bad}).refusals


def test_zero_offsets_are_an_ordinary_value() -> None:
    planned = DIALECT.plan(px4_parameters(), {1: FieldCorrection()})
    assert not planned.refusals
    assert {c.new for c in planned.changes if c.name.endswith("OFF")} == {0.0}


def test_what_a_person_should_know_is_said() -> None:
    def remarks(correction: FieldCorrection = GOOD, **parameters: float) -> str:
        return " ".join(DIALECT.plan(px4_parameters(**parameters), {1: correction}).remarks)

    assert "switched off" in remarks(CAL_MAG0_PRIO=0.0)
    assert remarks() == "" == remarks(FieldCorrection((-20.5, 130.0, -70.0)))  # calibrate has it load that
    assert (
        DIALECT.plan_values(px4_parameters(), {"CAL_MAG0_XOFF": 0.018}).remarks == ()
    )  # so has a write by hand


def test_the_motor_term_in_force_stays_without_a_remark() -> None:
    held = px4_parameters(CAL_MAG_COMP_TYP=2.0, CAL_MAG0_XCOMP=-0.01)
    motor = DIALECT.correction(held, 1)
    wanted = replace(motor, offsets_mgauss=(50.0, 60.0, 70.0))
    planned = DIALECT.plan(held, {1: wanted})
    assert planned.remarks == ()
    new = DIALECT.correction(held | {c.name: c.new for c in planned.changes}, 1)
    assert new.motor_mgauss == pytest.approx(wanted.motor_mgauss)


def test_a_motor_term_is_written_with_what_it_goes_by() -> None:
    held, motor = px4_parameters(CAL_MAG0_ROT=2.0), replace(GOOD, motor_mgauss=(3.0, -1.0, 0.5))
    planned = DIALECT.plan(held, {1: replace(motor, motor_source="current")})
    after = held | {c.name: c.new for c in planned.changes}
    assert not planned.refusals and after["CAL_MAG_COMP_TYP"] == 2.0
    assert DIALECT.correction(after, 1).motor_mgauss == pytest.approx(motor.motor_mgauss, abs=1e-4)
    # What the terms of another compass go by is not changed.
    held["CAL_MAG1_XCOMP"] = 0.2
    assert (
        "CAL_MAG_COMP_TYP is shared"
        in DIALECT.plan(held, {1: replace(motor, motor_source="current")}).refusals[0]
    )


def test_device_ids_are_not_written() -> None:
    assert "firmware's own" in DIALECT.plan_values(px4_parameters(), {"CAL_MAG0_ID": 1.0}).refusals[0]
    planned = DIALECT.plan_values(px4_parameters(), {"CAL_MAG0_PRIO": 75.0})
    assert [c.name for c in planned.changes] == ["CAL_MAG0_PRIO"] and not planned.refusals


def test_a_motors_field_is_told_per_kiloampere_or_at_full_throttle() -> None:
    # 10 A of 0.5 G/kA are 5 mG; half the throttle of 0.5 G is 250 mG.
    raw, load = np.array([[200.0, 0.0, 400.0]]), {2.0: 10.0, 1.0: 0.5}
    for kind, felt_mgauss in ((2.0, 5.0), (1.0, 250.0)):
        held = px4_parameters(CAL_MAG_COMP_TYP=kind, CAL_MAG0_XCOMP=0.5, CAL_MAG0_XOFF=0.0)
        found = DIALECT.correction(held, 1)
        without = DIALECT.correction({**held, "CAL_MAG_COMP_TYP": 0.0}, 1)
        moved = found.apply(raw, np.array([load[kind]])) - without.apply(raw)
        assert np.linalg.norm(moved) == pytest.approx(felt_mgauss, rel=0.02)


def test_rot_is_written_where_no_angle_can_make_it_100_again_both_ways() -> None:
    held = px4_parameters(CAL_MAG0_ROT=2.0)
    free = DIALECT.plan(held, {1: GOOD}, {1: rotation_of((10.0, 20.0, 30.0))})
    names = [c.name for c in free.changes]
    assert not free.refusals and names[0] == "CAL_MAG0_ROT" and free.changes[0].new == 100.0
    held |= {c.name: c.new for c in free.changes}
    back = rotation_of((10.0, 20.0, 30.0)).T
    numbered = DIALECT.plan(held, {1: GOOD}, {1: back})
    assert not numbered.refusals and numbered.changes[-1].name == "CAL_MAG0_ROT"
    assert (numbered.changes[-1].old, numbered.changes[-1].new) == (100.0, 2.0)
    # So does what a person writes, or restores from a file.
    wanted = {"CAL_MAG0_ROT": 4.0, "CAL_MAG0_YAW": 0.0, "CAL_MAG0_ROLL": 0.0, "CAL_MAG0_PITCH": 0.0}
    assert DIALECT.plan_values(held, wanted).changes[-1].name == "CAL_MAG0_ROT"


@given(finite_corrections, st.integers(0, 40), st.tuples(*[st.floats(-90.0, 90.0)] * 3))
def test_a_turned_compass_has_the_wanted_correction_in_its_new_axes(
    correction: FieldCorrection, mounting: int, angles_deg: tuple[float, float, float]
) -> None:
    held = px4_parameters(CAL_MAG0_ROT=float(mounting))
    planned = DIALECT.plan(held, {1: correction}, {1: rotation_of(angles_deg)})
    new = DIALECT.correction(held | {c.name: c.new for c in planned.changes}, 1)
    assert new.offsets_mgauss == pytest.approx(correction.offsets_mgauss, rel=1e-5, abs=5e-3)
    assert new.matrix == pytest.approx(correction.matrix, rel=1e-5, abs=1e-5)


def test_a_compass_inside_cannot_be_turned_and_rot_by_hand_is_judged() -> None:
    (refusal,) = DIALECT.plan(px4_parameters(), {1: GOOD}, {1: rotation_of((0, 0, 90))}).refusals
    assert "inside the flight controller" in refusal
    held = px4_parameters(CAL_MAG0_ROT=100.0, CAL_MAG0_YAW=5.0)
    assert "beside angles other than 0" in DIALECT.plan_values(held, {"CAL_MAG0_ROT": 4.0}).refusals[0]
    assert "no rotation that this PX4 knows" in DIALECT.plan_values(held, {"CAL_MAG0_ROT": 41.0}).refusals[0]
    assert not DIALECT.plan_values(held, {"CAL_MAG0_ROT": -1.0}).refusals  # PX4's word for one inside
