"""Each effect of the second generator changes what its name says; a gain of the sensor is one cause."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from vehicle_scenes import recorded, scene, vehicle_of

from mavcompass.frames import FloatArray as Array
from mavcompass.gap.diagnose import diagnose_gap
from mavcompass.gap.trial.vehicles.cases import CATALOGUE, OUTSIDE
from mavcompass.gap.trial.vehicles.effects.known import Kind, sized
from mavcompass.gap.trial.vehicles.scene import Effect, Scene, Stage, Values, ambient, readings, stream
from mavcompass.simulation.effects import catalogue


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
    "per_motor": lambda at, e, c: straightness(c, latest(at, at.loads.efforts)) < 1e-9,
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
