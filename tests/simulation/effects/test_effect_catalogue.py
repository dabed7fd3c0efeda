"""The registry: what a person can name, and what every forward model must keep."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavcompass import messages as m
from mavcompass.errors import UsageError
from mavcompass.frames import FloatArray, euler_to_matrix, rotate_back
from mavcompass.simulation import effects
from mavcompass.simulation.effects import Setting, catalogue, parse, spell
from mavcompass.simulation.effects.causes.world import _dipoles, _polished, dipole_field
from mavcompass.simulation.effects.effect import ON_IRON, Distortion, Signals
from mavcompass.simulation.effects.sampling import spread
from mavcompass.simulation.heading_error import heading_error_rms_deg
from mavcompass.simulation.physics.signals import Reading, Stimulus, ideal
from mavcompass.simulation.vehicle import SimulatedAutopilot

CONTRACT_IDS = """hard_iron hard_iron_step soft_iron axis_scale non_orthogonality misalignment orientation
motor_current per_motor ac_interference relay_field temperature_bias temperature_sensitivity
bias_random_walk clipping quantisation noise_excess transport_lag low_pass timestamp_jitter stale_samples
spatial_dipole field_gradient height_anomaly field_intensity inclination declination accel_bias accel_scale
linear_acceleration vibration_rectification gyro_bias gyro_scale yaw_step_error platform_tilt hysteresis
cross_axis set_reset_offset eddy_current attitude_reference_error""".split()
FIELD = np.array([230.0, 50.0, -530.0])


def moving(n: int = 400, dt: float = 0.02) -> tuple[Stimulus, Reading]:
    """A vehicle that turns, rolls and pitches, with its currents and temperature."""
    t = np.arange(n) * dt
    roll, pitch, yaw = 0.3 * np.sin(1.1 * t), 0.2 * np.cos(0.7 * t), 0.8 * t
    rotation = euler_to_matrix(roll, pitch, yaw)
    step = np.einsum("nji,njk->nik", rotation[:-1], rotation[1:])
    rate = np.stack([step[:, 2, 1], step[:, 0, 2], step[:, 1, 0]], axis=1) / dt
    rate = np.vstack([rate, rate[-1:]])
    field = np.tile(FIELD, (n, 1))
    force = rotate_back(rotation, np.tile([0.0, 0.0, -9.80665], (n, 1)))
    position = np.stack([np.sin(0.3 * t), np.cos(0.2 * t), 0.1 * t], axis=1)
    motors = 0.5 + 0.3 * np.sin(t[:, None] + np.arange(4))
    stimulus = Stimulus(
        t, rotation, field, rate, force, position, np.zeros((n, 3)),
        10.0 + 5.0 * np.sin(t), 0.5 + 0.4 * np.sin(t), 25.0 + t, motors,
    )  # fmt: skip
    return stimulus, Reading(rotate_back(rotation, field), force, rate)


def cut(stimulus: Stimulus, rows: slice) -> Stimulus:
    return Stimulus(*(getattr(stimulus, name)[rows] for name in Stimulus.__slots__))


def test_catalogue_holds_every_effect_that_others_rely_on() -> None:
    assert set(CONTRACT_IDS) <= set(effects.catalogue())


@pytest.mark.parametrize("effect_id", CONTRACT_IDS)
def test_effect_says_what_a_person_must_know(effect_id: str) -> None:
    effect = effects.get(effect_id)
    assert effect.title and effect.separated_by and effect.source
    assert set(effect.aliases) <= set(effects.catalogue())
    assert (effect.lower <= effect.default).all() and (effect.default <= effect.upper).all()


@pytest.mark.parametrize("effect_id", sorted(set(CONTRACT_IDS) - {"stale_samples", "orientation"}))
def test_typical_setting_changes_the_readings(effect_id: str) -> None:
    stimulus, reading = moving()
    text = {"hard_iron_step": "hard_iron_step:x=50,on_s=3,off_s=6"}.get(effect_id, effect_id)
    out = effects.Distortion([effects.parse(text)]).apply(stimulus, reading, np.random.default_rng(1))
    changed = [np.abs(getattr(out, n) - getattr(reading, n)).max() for n in Reading.__slots__]
    assert max(changed) > 1e-3


@pytest.mark.parametrize(
    "effect_id", [i for i in CONTRACT_IDS if effects.get(i).kind in ("mean", "discrete")]
)
def test_live_blocks_give_what_the_whole_recording_gives(effect_id: str) -> None:
    stimulus, reading = moving()
    rng = np.random.default_rng(2)
    whole = effects.Distortion([effects.default(effect_id)]).apply(stimulus, reading, rng)
    live = effects.Distortion([effects.default(effect_id)])
    edges = [0, 1, 2, 5, 90, 91, 250, 400]
    parts = [
        live.apply(
            cut(stimulus, slice(a, b)), Reading(*(getattr(reading, n)[a:b] for n in Reading.__slots__)), rng
        )
        for a, b in pairwise(edges)
    ]
    # A live block does not know the future: slopes at its end are one-sided there.
    tolerance = 0.05 if effect_id in ("transport_lag", "linear_acceleration") else 1e-9
    for name in Reading.__slots__:
        joined = np.vstack([getattr(part, name) for part in parts])
        error = np.abs(joined - getattr(whole, name))
        effect = np.abs(getattr(whole, name) - getattr(reading, name)).max()
        assert np.quantile(error, 0.9) <= tolerance * max(effect, 1.0)


def test_lag_of_a_steady_turn_is_the_field_of_the_angle_before() -> None:
    n, rate, lag = 300, 0.5, 0.06
    t = np.arange(n) * 0.02
    rotation = euler_to_matrix(0.0, 0.0, rate * t)
    stimulus, reading = moving(n)
    mag = rotate_back(rotation, np.tile(FIELD, (n, 1)))
    out = effects.Distortion([effects.parse(f"transport_lag:lag_s={lag}")]).apply(
        stimulus, Reading(mag, reading.acc_mps2, reading.gyro_radps), np.random.default_rng(0)
    )
    expected = rotate_back(euler_to_matrix(0.0, 0.0, rate * (t - lag)), np.tile(FIELD, (n, 1)))
    np.testing.assert_allclose(out.mag_mgauss[10:], expected[10:], atol=1e-3)


def test_dipole_on_its_axis_is_twice_the_moment_over_the_cube() -> None:
    field = dipole_field(np.array([[2.0, 0.0, 0.0]]), np.zeros(3), np.array([80.0, 0.0, 0.0]))
    np.testing.assert_allclose(field, [[20.0, 0.0, 0.0]], rtol=4e-3)


def test_person_is_told_what_is_wrong_with_an_effect() -> None:
    with pytest.raises(UsageError, match="Did you mean hard_iron"):
        effects.parse("hard_irn")
    with pytest.raises(UsageError, match="Its parameters are x, y, z"):
        effects.parse("hard_iron:w=3")
    with pytest.raises(UsageError, match="not physical"):
        effects.parse("hard_iron:x=1e9")
    with pytest.raises(UsageError, match="NAME:param=value"):
        effects.parse("hard_iron:x")


def test_named_parameters_leave_the_other_amplitudes_zero() -> None:
    assert effects.parse("hard_iron:x=100,y=-50").theta.tolist() == [100.0, -50.0, 0.0]
    assert effects.parse("hard_iron").theta.any()


@settings(max_examples=40, deadline=None)
@given(st.lists(st.floats(-0.3, 0.3), min_size=3, max_size=3))
def test_attitude_effects_keep_the_length_of_the_field(angles: list[float]) -> None:
    stimulus, reading = moving(50)
    setting = effects.Setting(effects.get("attitude_reference_error"), np.array(angles))
    out = effects.Distortion([setting]).apply(stimulus, reading, np.random.default_rng(0))
    length = np.linalg.norm(out.mag_mgauss, axis=1)
    np.testing.assert_allclose(length, np.linalg.norm(FIELD), rtol=1e-9)


def test_spread_leaves_out_what_is_missing_and_says_nothing_of_nothing() -> None:
    values = np.array([[1.0, np.nan, 2.0], [3.0, np.nan, np.nan], [5.0, np.nan, 2.0]])
    np.testing.assert_allclose(spread(values), [np.std([1.0, 3.0, 5.0]), 0.0, 0.0])


@pytest.mark.parametrize("seed", range(20))
def test_climbing_takes_away_nearly_all_that_the_magnet_itself_would(seed: int) -> None:
    rng = np.random.default_rng(seed)
    time = np.linspace(0.0, 100.0, 400)
    around = [10.0 * np.sin(time / 9.0 + rng.uniform(0.0, 6.0)), 8.0 * np.sin(time / 7.0)]
    path = np.stack([*around, -1.0 - rng.uniform() * np.sin(time / 20.0)], axis=1)
    source = path[rng.integers(400)] + rng.normal(0.0, 1.5, 3)
    field = dipole_field(path, source, rng.normal(0.0, 200.0, 3)) + rng.normal(0.0, 2.0, (400, 3))
    peak = path[np.argsort(-np.linalg.norm(field, axis=1))[:40]].mean(axis=0)
    found = _polished(path, field, peak + rng.normal(0.0, 0.5, (3, 3)), 2.0)
    (best,), _ = _dipoles(path, field, source[None])
    assert _dipoles(path, field, found)[0].max() > 0.97 * best


# --- Errors of the sensor itself: on the vehicle's iron too, or on the field alone


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


# --- Further physical effects on a live simulated vehicle


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
