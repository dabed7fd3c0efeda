"""FieldCorrection: what the autopilots do to a reading, and back."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavcompass.compass_parameters import (
    ardupilot_correction,
    ardupilot_correction_names,
    ardupilot_name,
    ardupilot_values,
    px4_correction,
    px4_rotation,
    px4_values,
)
from mavcompass.correction import IDENTITY, FieldCorrection
from mavcompass.errors import PoorCalibration

offsets = st.tuples(*[st.floats(-1000, 1000)] * 3)
diagonals = st.tuples(*[st.floats(0.7, 1.4)] * 3)
off_diagonals = st.tuples(*[st.floats(-0.15, 0.15)] * 3)
corrections = st.builds(
    FieldCorrection,
    offsets_mgauss=offsets,
    diagonals=diagonals,
    off_diagonals=off_diagonals,
    scale=st.floats(0.7, 1.4),
    motor_mgauss=st.tuples(*[st.floats(-10, 10)] * 3),
    motor_source=st.just("current"),
)
RAW = np.array([[200.0, -50.0, 400.0], [0.0, 0.0, 0.0], [-130.5, 220.25, -480.0]])
AMPERES = np.array([0.0, 12.5, 30.0])


def test_the_form_is_matrix_times_scaled_shifted_field_plus_motor() -> None:
    correction = FieldCorrection(
        (10.0, -20.0, 30.0), (1.1, 0.9, 1.0), (0.01, 0.02, 0.03), 1.2, (1.0, 2.0, 3.0), "current"
    )
    shifted = np.array([110.0, 180.0, 330.0]) * 1.2
    matrix = np.array([[1.1, 0.01, 0.02], [0.01, 0.9, 0.03], [0.02, 0.03, 1.0]])
    expected = matrix @ shifted + np.array([1.0, 2.0, 3.0]) * 5.0
    assert correction.apply([100.0, 200.0, 300.0], 5.0) == pytest.approx(expected)


@given(corrections)
def test_undoing_gives_the_raw_reading_back(correction: FieldCorrection) -> None:
    assert correction.undo(correction.apply(RAW, AMPERES), AMPERES) == pytest.approx(RAW, abs=1e-6)


@given(corrections, corrections)
def test_composed_corrections_do_what_one_after_the_other_does(
    first: FieldCorrection, second: FieldCorrection
) -> None:
    scaled = FieldCorrection(second.offsets_mgauss, scale=second.scale)
    composed = first.then(scaled)
    assert composed.apply(RAW) == pytest.approx(scaled.apply(first.apply(RAW)), abs=1e-6)


def test_a_product_that_no_autopilot_can_hold_is_refused() -> None:
    skewed = FieldCorrection(diagonals=(1.2, 0.9, 1.0))
    crossed = FieldCorrection(off_diagonals=(0.1, 0.0, 0.0))
    with pytest.raises(ValueError, match="symmetric"):
        skewed.then(crossed)


def test_an_unknown_motor_load_adds_nothing() -> None:
    correction = FieldCorrection(motor_mgauss=(1.0, 1.0, 1.0), motor_source="current")
    assert correction.apply(RAW, np.array([np.nan, 0.0, np.nan])) == pytest.approx(RAW)


@given(corrections)
def test_ardupilot_parameters_hold_a_correction(correction: FieldCorrection) -> None:
    for instance in (1, 2, 3):
        for naming in ("COMPASS_OFS2_X", "COMPASS2_OFS_X"):
            values = ardupilot_values(correction, instance, naming)
            assert all(len(name) <= 16 for name in values)
            scheme = {"COMPASS1_OFS_X": 0.0} if naming == "COMPASS2_OFS_X" else {}
            assert ardupilot_correction(scheme | values, instance) == correction


def test_ardupilot_spells_its_parameters_by_instance_and_scheme() -> None:
    assert ardupilot_name("OFS_X", 1) == "COMPASS_OFS_X"
    assert ardupilot_name("DIA_Y", 3) == "COMPASS_DIA3_Y"
    assert ardupilot_name("SCALE", 2) == "COMPASS_SCALE2"
    assert ardupilot_name("EXTERNAL", 2) == "COMPASS_EXTERN2"
    assert ardupilot_name("DEV_ID", 2) == "COMPASS_DEV_ID2"
    assert ardupilot_name("OFS_X", 2, "COMPASS2_OFS_X") == "COMPASS2_OFS_X"
    assert len(ardupilot_correction_names(1)) == 13


def test_ardupilot_without_a_matrix_or_with_a_wild_scale_uses_none() -> None:
    zero = dict.fromkeys(ardupilot_correction_names(1), 0.0)
    assert ardupilot_correction(zero, 1) == IDENTITY
    for ignored in (0.6, 1.6, 0.0):
        assert ardupilot_correction({"COMPASS_SCALE": ignored}, 1).scale == 1.0
    assert ardupilot_correction({"COMPASS_SCALE": 1.3}, 1).scale == 1.3


@given(corrections, st.sampled_from([-1, 0, 2, 4, 6, 8, 24, 35]))
def test_px4_parameters_hold_a_correction_in_the_sensors_axes(
    correction: FieldCorrection, orientation: int
) -> None:
    parameters = {"CAL_MAG0_ROT": float(orientation)}
    values = px4_values(correction, 1, px4_rotation(parameters, 1))
    back = px4_correction(parameters | values, 1)
    assert back.apply(RAW) == pytest.approx(correction.apply(RAW), abs=1e-6)


def test_px4_subtracts_gauss_before_the_rotation() -> None:
    parameters = {"CAL_MAG0_ROT": 2.0, "CAL_MAG0_XOFF": 0.1}  # yaw 90: sensor x is body y
    field = px4_correction(parameters, 1).apply(px4_rotation(parameters, 1) @ np.array([300.0, 0.0, 0.0]))
    assert field == pytest.approx([0.0, 200.0, 0.0], abs=1e-9)


def test_a_matrix_without_inverse_says_what_to_set() -> None:
    with pytest.raises(PoorCalibration, match="no inverse") as caught:
        FieldCorrection(diagonals=(1.0, 0.0, 1.0)).undo([1.0, 2.0, 3.0])
    assert "COMPASS_DIA" in caught.value.remedy


def test_a_scale_that_was_not_heard_counts_as_one() -> None:
    heard = {"COMPASS_DIA_X": 1.1, "COMPASS_DIA_Z": 0.9, "COMPASS_ODI_X": 0.02}
    found = ardupilot_correction(heard, 1)
    assert (found.diagonals, found.off_diagonals) == ((1.1, 1.0, 0.9), (0.02, 0.0, 0.0))


def test_nothing_said_is_nothing_done() -> None:
    nothing = ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0), 1.0, (0.0, 0.0, 0.0), "none")
    assert FieldCorrection(*nothing) == IDENTITY == FieldCorrection.from_matrix((0.0, 0.0, 0.0), np.eye(3))
    assert IDENTITY.apply(RAW) == pytest.approx(RAW) and IDENTITY.undo(RAW, AMPERES) == pytest.approx(RAW)


@pytest.mark.parametrize(("apart", "is_symmetric"), [(0.9e-9, True), (1.1e-9, False), (-1.1e-9, False)])
def test_a_matrix_is_symmetric_to_a_billionth_of_its_largest_entry(apart: float, is_symmetric: bool) -> None:
    matrix = 2.0 * np.eye(3)
    matrix[0, 1], matrix[1, 0] = 0.2 + 2.0 * apart, 0.2
    if is_symmetric:
        assert FieldCorrection.from_matrix((1.0, 2.0, 3.0), matrix, 2.0).off_diagonals[0] == pytest.approx(
            0.1
        )
    else:
        with pytest.raises(ValueError, match="symmetric"):
            FieldCorrection.from_matrix((1.0, 2.0, 3.0), matrix, 2.0)


def test_motor_terms_compose_where_they_go_with_one_load() -> None:
    first = FieldCorrection((5.0, 0.0, 0.0), scale=2.0, motor_mgauss=(1.0, 2.0, 3.0), motor_source="current")
    later = FieldCorrection((1.0, 0.0, 0.0), scale=1.5, motor_mgauss=(0.5, 0.0, -1.0), motor_source="current")
    both = first.then(later)
    assert both.motor_mgauss == pytest.approx((2.0, 3.0, 3.5)) and both.motor_source == "current"
    assert both.apply(RAW, AMPERES) == pytest.approx(later.apply(first.apply(RAW, AMPERES), AMPERES))
    with pytest.raises(ValueError, match="different motor loads"):
        first.then(FieldCorrection(motor_mgauss=(1.0, 0.0, 0.0), motor_source="throttle"))
    plain = first.then(FieldCorrection((1.0, 0.0, 0.0)))
    assert (plain.motor_mgauss, plain.motor_source) == (first.motor_mgauss, "current")
    carried = FieldCorrection(diagonals=(3.0, 2.0, 1.0)).with_motor_of(first)
    assert carried.motor_mgauss == pytest.approx((1.5, 2.0, 1.5)) and carried.motor_source == "current"
