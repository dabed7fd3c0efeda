"""Further physical effects on a live simulated vehicle."""

import math

import numpy as np
import pytest

from mavcompass import messages as m
from mavcompass.simulation.heading_error import heading_error_rms_deg
from mavcompass.simulation.vehicle import SimulatedAutopilot


def stream(vehicle="rover", seconds=4.0, cuts=1, **options):
    v = SimulatedAutopilot(vehicle, seed=3, **options)
    for number in (27, 116):
        v.receive(m.CommandLong(1, 1, 511, 0, float(number), 25_000.0), 255, 190)
    v.receive(m.SetPositionTargetLocalNed(0, 1, 1, 1, 0x5FF, yaw_rate=0.5), 255, 190)
    out = [o for t in np.linspace(seconds / cuts, seconds, cuts) for o in v.advance(float(t))]
    return v, [o.message for o in out if type(o.message) in (m.RawImu, m.ScaledImu2)]


def column(messages, kind, *names):
    return np.array([[getattr(i, n) for n in names] for i in messages if type(i) is kind], dtype=float)


def test_an_effect_is_all_that_is_wrong_with_the_first_compass():
    plain, _ = stream(calibration="exact")
    bent, _ = stream(effects=["hard_iron:x=100,y=-50"])
    assert heading_error_rms_deg(plain) < 1e-4
    assert heading_error_rms_deg(bent) > 15.0
    assert heading_error_rms_deg(bent, instance=2) < 1e-4


def test_a_gyro_bias_shows_in_the_gyro():
    _, plain = stream(calibration="exact", armed=False)
    _, biased = stream(effects=["gyro_bias:z=0.02"], armed=False)
    shift = column(biased, m.RawImu, "zgyro").mean() - column(plain, m.RawImu, "zgyro").mean()
    assert shift == pytest.approx(20.0, abs=1.5)  # what the truncation of small numbers leaves


def test_motor_current_bends_a_hovering_copters_field():
    calm, pulled = (
        SimulatedAutopilot("copter", seed=1, calibration="exact", effects=e)
        for e in ((), ("motor_current:x=2",))
    )
    assert heading_error_rms_deg(calm) < 1e-4
    expected = math.degrees(2.0 * 28.0 / calm.world.horizontal_mgauss / math.sqrt(2.0))
    assert heading_error_rms_deg(pulled) == pytest.approx(expected, rel=0.25)


@pytest.mark.parametrize(
    "effects", [["hard_iron", "transport_lag", "noise_excess"], ["soft_iron", "gyro_bias"]]
)
def test_effects_are_reproducible_however_time_is_cut(effects):
    _, whole = stream(effects=effects)
    _, cut = stream(effects=effects, cuts=173)
    assert whole == cut


def test_judging_leaves_the_vehicle_as_it_is():
    effects = ["hard_iron", "transport_lag", "noise_excess"]
    v, _ = stream(effects=effects)
    heading_error_rms_deg(v)
    w, _ = stream(effects=effects)
    assert v.advance(6.0) == w.advance(6.0)


def test_a_lag_does_not_count_as_a_heading_error_at_rest():
    v, _ = stream(effects=["transport_lag:lag_s=0.2"])
    assert heading_error_rms_deg(v) < 0.01
