"""A gain of the sensor is one cause, whether the vehicle's iron goes through it or not."""

from __future__ import annotations

import numpy as np
import pytest
from vehicle_scenes import recorded, scene, vehicle_of

from mavcompass.frames import FloatArray as Array
from mavcompass.gap.diagnose import diagnose_gap
from mavcompass.gap.trial.vehicles.scene import Effect, Scene, Stage, Values

_GAIN = {"x": 0.11, "y": -0.08, "z": 0.05}


def _scaled(values: Array, p: Values, at: Scene, rng: np.random.Generator) -> Array:
    return values * (1.0 + np.array([p["x"], p["y"], p["z"]]))


@pytest.mark.parametrize(("stage", "on_iron"), [(Stage.SENSOR, 1.0), (Stage.AMBIENT, 0.0)])
def test_gain_is_told_with_what_it_acts_on(stage: Stage, on_iron: float) -> None:
    vehicle = vehicle_of(4, "copter")
    assert np.abs(vehicle.compass.iron_mgauss).max() > 50.0
    baseline = recorded(scene(vehicle, "wander", 80.0, 6)).track
    flight = recorded(scene(vehicle, "hand", 80.0, 7), Effect("axis_scale", stage, _scaled, _GAIN)).track
    found = diagnose_gap(flight, baseline)
    (cause,) = found.causes
    assert cause.effect == "axis_scale"
    assert cause.parameters["on_iron"] == on_iron
    assert {name: cause.parameters[name] for name in _GAIN} == pytest.approx(_GAIN, abs=0.02)
    assert found.field.after < 1.25 * found.field.floor
