"""Errors of the sensor itself: on the vehicle's iron too, or on the field alone."""

from __future__ import annotations

import numpy as np
import pytest

from mavcompass.frames import FloatArray
from mavcompass.simulation.effects import Setting, catalogue, parse, spell
from mavcompass.simulation.effects.effect import ON_IRON, Distortion, Signals
from mavcompass.simulation.physics.signals import Stimulus, ideal

_FIELD = np.array([[220.0, -40.0, 410.0], [-180.0, 90.0, 380.0]])
_IRON = np.array([60.0, -25.0, 140.0])
_OF_THE_SENSOR = sorted(effect.id for effect in catalogue().values() if ON_IRON in effect.names)


def _run(field: FloatArray, *texts: str) -> FloatArray:
    n = len(field)
    turned, warm = np.tile(np.eye(3), (n, 1, 1)), np.full(n, 45.0)
    stimulus = Stimulus.posed(np.arange(n, dtype=np.float64), turned, field, temperature_degc=warm)
    settings = [parse(text) for text in texts]
    return Distortion(settings).run(Signals(stimulus, ideal(stimulus)), None).reading.mag_mgauss


def test_gains_axes_and_turns_are_of_the_sensor() -> None:
    assert _OF_THE_SENSOR == [
        "axis_scale", "cross_axis", "misalignment", "non_orthogonality", "temperature_sensitivity",
    ]  # fmt: skip


def test_gain_of_all_that_the_sensor_feels_scales_the_iron_too() -> None:
    iron = "hard_iron:x=60,y=-25,z=140"
    gain = 1.0 + np.array([0.1, -0.05, 0.02])
    scale = "axis_scale:x=0.1,y=-0.05,z=0.02"
    assert _run(_FIELD, iron, f"{scale},on_iron=1") == pytest.approx((_FIELD + _IRON) * gain)
    assert _run(_FIELD, iron, f"{scale},on_iron=0") == pytest.approx(_FIELD * gain + _IRON)
    assert _run(_FIELD, iron, scale) == pytest.approx(_FIELD * gain + _IRON)


@pytest.mark.parametrize("effect_id", _OF_THE_SENSOR)
def test_it_acts_on_the_iron_as_on_a_field(effect_id: str) -> None:
    effect = catalogue()[effect_id]
    on = effect.names.index(ON_IRON)
    theta = np.array([*effect.default[:on], 1.0])
    text = spell(Setting(effect, theta))
    assert parse(text).theta == pytest.approx(theta)
    assert _run(_FIELD, "hard_iron:x=60,y=-25,z=140", text) == pytest.approx(_run(_FIELD + _IRON, text))
    theta[on] = 0.0
    before = spell(Setting(effect, theta))
    assert _run(_FIELD, "hard_iron:x=60,y=-25,z=140", before) == pytest.approx(_run(_FIELD, before) + _IRON)
