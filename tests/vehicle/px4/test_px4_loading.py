"""A calibration that PX4 loads on the ground: written again, made to load, the heading reset."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from parameter_vehicle import PX4Vehicle, Radio, px4_parameters

from mavcompass.errors import Refused, WriteFailed
from mavcompass.messages import ParamSet
from mavcompass.procedure.script import Context, Script
from mavcompass.vehicle.dialects import make_dialect
from mavcompass.vehicle.dialects.taking_over import PX4_HOW, load_px4

NEW = {"CAL_MAG0_XOFF": 0.12, "CAL_MAG0_YOFF": -0.08, "CAL_MAG0_XSCALE": 0.9}


def loading(context: Context) -> Script[Any]:
    return load_px4(context, NEW)


def offsets_sent(radio: Radio) -> list[float]:
    return [m.param_value for m in radio.sent if isinstance(m, ParamSet) and m.param_id == "CAL_MAG0_XOFF"]


def test_what_disarming_has_overwritten_is_written_again() -> None:
    vehicle = PX4Vehicle(px4_parameters(**NEW) | {"CAL_MAG0_XOFF": 0.07, "CAL_MAG0_XSCALE": 1.0})
    radio = Radio(vehicle)
    assert radio.run(loading) == PX4_HOW
    assert {name: vehicle.values[name] for name in NEW} == {n: float(np.float32(v)) for n, v in NEW.items()}
    assert any("had put other values" in show.text for show in radio.shown)


def test_an_estimator_on_the_ground_has_nothing_left_to_take_for_a_bias() -> None:
    prompt, shipped = make_dialect("px4").prompt_estimator, {"EKF2_GPS_CTRL": 7.0, "EKF2_MAG_NOISE": 0.05}
    assert prompt(shipped, False) == {"EKF2_GPS_CTRL": 0.0, "EKF2_MAG_NOISE": 0.002}
    assert prompt(shipped, True) == prompt({"EKF2_GPS_CTRL": 0.0, "EKF2_MAG_NOISE": 0.001}, False) == {}


def test_what_resets_no_heading_is_not_made_to_load() -> None:
    radio = Radio(PX4Vehicle(px4_parameters(**NEW)))
    assert radio.run(lambda context: load_px4(context, {"CAL_MAG0_YOFF": -0.08})) == ""
    assert not any(isinstance(message, ParamSet) for message in radio.sent)


@pytest.mark.parametrize("seed", range(3))
def test_px4_sees_another_calibration_and_then_the_right_one(seed: int) -> None:
    vehicle = PX4Vehicle(px4_parameters(**NEW))
    radio = Radio(vehicle, seed=seed, loss=0.2, silence_s=15.0)
    assert radio.run(loading) == PX4_HOW
    assert max(offsets_sent(radio)) == pytest.approx(0.131)
    # A matrix that differs by less than 0.01 would not be loaded: it is moved, too.
    scales = [
        m.param_value for m in radio.sent if isinstance(m, ParamSet) and m.param_id == "CAL_MAG0_XSCALE"
    ]
    assert max(scales) == pytest.approx(0.921) and scales[-1] == pytest.approx(0.9)
    assert vehicle.values["CAL_MAG0_XOFF"] == float(np.float32(0.12))


def test_all_is_written_before_px4_stores_what_was_changed() -> None:
    radio = Radio(PX4Vehicle(px4_parameters(**NEW)))
    radio.run(loading)
    set_s = [at_s for at_s, m in zip(radio.sent_s, radio.sent, strict=True) if isinstance(m, ParamSet)]
    assert 0.1 <= set_s[-1] - set_s[0] <= 0.25


@pytest.mark.parametrize("stop_s", [0.06, 0.14, 0.22])
def test_a_stop_in_between_leaves_nothing_moved(stop_s: float) -> None:
    vehicle = PX4Vehicle(px4_parameters(**NEW))
    with pytest.raises(Refused):
        Radio(vehicle, stop_s=stop_s).run(loading)
    assert vehicle.values["CAL_MAG0_XOFF"] == float(np.float32(0.12))


def test_a_link_that_is_cut_in_between_is_told_with_the_value_to_set() -> None:
    vehicle = PX4Vehicle(px4_parameters(**NEW))
    with pytest.raises(WriteFailed, match=r"may be 11 mG and 0\.02 off"):
        Radio(vehicle, cut_s=0.12, silence_s=60.0).run(loading)
    assert vehicle.values["CAL_MAG0_XOFF"] != float(np.float32(0.12))
