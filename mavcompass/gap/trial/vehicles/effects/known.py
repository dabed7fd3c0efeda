"""Kinds of effects, and those that the catalogue names, made once more: where each acts, what is drawn of it.

Fields of the world and of the vehicle (iron, currents, places, hulls), and faults of the sensor (axes,
gains, electronics, timing).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy

from mavcompass.frames import FloatArray as Array
from mavcompass.frames import rotvec_to_matrix, sensor_orientation_matrix
from mavcompass.gap.trial.vehicles.draw import unit
from mavcompass.gap.trial.vehicles.motion import STEP_S
from mavcompass.gap.trial.vehicles.scene import Effect, Scene, Stage, Values, readings, stream

Rng = np.random.Generator
Grow = Callable[[float], Values]
AXES = "xyz"
FLOOR_MGAUSS = 3.0
SMALLEST, LARGEST = 0.5, 12.0
_NEAR_ENOUGH = 0.03
_TRIES = 7


@dataclass(frozen=True, slots=True)
class Kind:
    """Describe a kind of effect.

    Attributes:
        id: its name; stage: where in the chain it acts.
        draw: draws all but the size and returns what makes the parameters from a size.
        act: changes the values (M, 3) of its stage.
        first, most: a size to try first, and the largest that nature offers.
        needs: "way" a path, "near" a small one on the ground, "loads" motors that work, "altitude", "wheels",
            "warming", "each_row" a compass whose readings are not averaged and repeated.
        sized: False for what has no size.
    """

    id: str
    stage: Stage
    draw: Callable[[Rng, Scene], Grow]
    act: Callable[[Array, Values, Scene, Rng], Array]
    first: float
    most: float
    needs: frozenset[str] = frozenset()
    sized: bool = True


def of(values: Values, names: tuple[str, ...] | str = AXES) -> Array:
    """Pick named values as an array."""
    return np.array([values[name] for name in names])


def grown(rng: Rng, names: tuple[str, ...] | str = AXES, **others: float) -> Grow:
    """Let named components grow along a drawn direction, beside values that stay."""
    along = unit(rng, len(names))
    return lambda size: {**dict(zip(names, (size * along).tolist(), strict=True)), **others}


def only(name: str) -> Callable[[Rng, Scene], Grow]:
    """Draw nothing: one named value is the size."""
    return lambda rng, scene: lambda size: {name: size}


def along(names: tuple[str, ...] | str = AXES) -> Callable[[Rng, Scene], Grow]:
    """Draw a direction for named components."""
    return lambda rng, scene: grown(rng, names)


def reference(rng: Rng, scene: Scene) -> float:
    """Draw the temperature at which nothing is added, near that of the start, degC."""
    return float(scene.loads.temperature_degc[0] + rng.normal(0.0, 2.0))


def above(p: Values, scene: Scene) -> Array:
    """Return the temperature above the reference, (N, 1), degC."""
    return scene.loads.temperature_degc[:, None] - p["reference_degc"]


def changed_rms(scene: Scene, effects: tuple[Effect, ...]) -> float:
    """Return how much effects change the raw readings without noise: rms per axis, milligauss."""
    plain = readings(scene, scene.plain_mgauss)
    return _rms(readings(scene, stream(scene, effects), effects) - plain)


def sized(kind: Kind, scene: Scene, target_mgauss: float, rng: np.random.Generator) -> Effect | None:
    """Draw an effect that changes the readings by a target (rms per axis); None where nature offers no such.

    What reaches a natural limit below the target is taken as long as it changes half a floor.
    """
    seed = int(rng.integers(2**62))
    grow = kind.draw(rng, scene)

    def of_size(size: float) -> Effect:
        return Effect(kind.id, kind.stage, kind.act, grow(size), seed)

    if not kind.sized:
        return of_size(1.0)
    plain = readings(scene, scene.plain_mgauss)
    size, power, before = kind.first, 1.0, (0.0, 0.0)
    for _ in range(_TRIES):
        effect = of_size(size)
        change = _rms(readings(scene, stream(scene, (effect,)), (effect,)) - plain)
        if change <= 0.0:
            return None
        if abs(change / target_mgauss - 1.0) < _NEAR_ENOUGH:
            return effect
        if size == kind.most and change < target_mgauss:
            return effect if change >= SMALLEST * FLOOR_MGAUSS else None
        here = (float(np.log(size)), float(np.log(change)))
        if before != (0.0, 0.0) and abs(here[0] - before[0]) > 1e-6:
            power = float(np.clip((here[1] - before[1]) / (here[0] - before[0]), 0.3, 3.0))
        before = here
        size = min(size * float((target_mgauss / change) ** (1.0 / power)), kind.most)
    inside = SMALLEST * FLOOR_MGAUSS <= change <= LARGEST * FLOOR_MGAUSS
    return effect if inside else None


def _rms(change: np.ndarray) -> float:
    return float(np.sqrt(np.mean(change**2)))


_FARTHEST_M = 800.0
_PAIRS = ("xx", "yy", "zz", "xy", "xz", "yz")
_CROSSED = ("xy", "xz", "yx", "yz", "zx", "zy")
_BELOW = ("yx", "zx", "zy")
_GAUSS = 1000.0


def _hard_iron_step(rng: Rng, scene: Scene) -> Grow:
    length = scene.motion.time_s[-1]
    on = rng.uniform(0.15, 0.7) * length
    moments = {"on_s": scene.start_s + on}
    if rng.random() < 0.5:
        moments["off_s"] = scene.start_s + on + max(rng.uniform(0.15, 0.8) * (length - on), 6.0)
    return grown(rng, AXES, **moments)


def _act_step(values: Array, p: Values, scene: Scene, rng: Rng) -> Array:
    time = scene.start_s + scene.motion.time_s
    there = (time >= p["on_s"]) & (time < p.get("off_s", np.inf))
    return values + np.where(there[:, None], of(p), 0.0)


def _act_soft_iron(values: Array, p: Values, scene: Scene, rng: Rng) -> Array:
    xx, yy, zz, xy, xz, yz = of(p, _PAIRS)
    return values + values @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _draw_per_motor(rng: Rng, scene: Scene) -> Grow:
    count = scene.loads.motors.shape[1]
    return grown(rng, tuple(f"motor{m + 1}_{axis}" for m in range(count) for axis in AXES))


def _act_per_motor(values: Array, p: Values, scene: Scene, rng: Rng) -> Array:
    out = values.copy()
    for motor, effort in enumerate(scene.loads.efforts.T):
        out += np.outer(effort, [p[f"motor{motor + 1}_{axis}"] for axis in AXES])
    return out


def _load(scene: Scene, source: int) -> Array:
    loads = scene.loads
    return (loads.throttle, loads.current_a)[source] if source < 2 else loads.motors[:, source - 2]


def _draw_relay(rng: Rng, scene: Scene) -> Grow:
    source = int(rng.integers(2 + scene.loads.motors.shape[1]))
    threshold = float(np.quantile(_load(scene, source), rng.uniform(0.3, 0.7)))
    return grown(rng, source=float(source), threshold=threshold)


def _draw_dipole(rng: Rng, scene: Scene) -> Grow:
    path = scene.motion.position_m
    path = path[np.abs(path).max(axis=1) < _FARTHEST_M]
    closest = 1.0 if scene.vehicle.receiver == "gps" else 0.6
    place = path[0] + np.array([4.0, 0.0, 0.0])
    for _ in range(10):
        near = path[round(rng.uniform(0.15, 0.85) * (len(path) - 1))]
        away, toward = np.exp(rng.uniform(np.log(closest), np.log(4.0))), rng.uniform(0.0, 2.0 * np.pi)
        place = near + away * np.array([np.cos(toward), np.sin(toward), rng.uniform(-0.3, 0.5)])
        if ((path[::20] - place) ** 2).sum(axis=1).min() > (0.8 * closest) ** 2:
            break
    where = dict(zip(("north_m", "east_m", "down_m"), place.tolist(), strict=True))
    return grown(rng, ("moment_north", "moment_east", "moment_down"), **where)


def _act_dipole(values: Array, p: Values, scene: Scene, rng: Rng) -> Array:
    apart = scene.motion.position_m - of(p, ("north_m", "east_m", "down_m"))
    return values + dipole(apart, of(p, ("moment_north", "moment_east", "moment_down")))


def dipole(apart_m: Array, moment_mgauss_m3: Array) -> Array:
    """Return the field (N, 3) at places (N, 3) from a dipole; mu0 / 4 pi is in its mG m^3."""
    square = np.maximum((apart_m**2).sum(axis=1, keepdims=True), 0.01)
    along = (apart_m * moment_mgauss_m3).sum(axis=1, keepdims=True)
    return np.asarray(3.0 * apart_m * along / square**2.5 - moment_mgauss_m3 / square**1.5)


def _act_gradient(values: Array, p: Values, scene: Scene, rng: Rng) -> Array:
    nn, ee, ne, nd, ed = of(p, ("nn", "ee", "ne", "nd", "ed"))
    n, e, d = scene.motion.position_m.T
    # The gradient of a potential that solves Laplace's equation.
    return values + np.stack(
        [nn * n + ne * e + nd * d, ne * n + ee * e + ed * d, nd * n + ed * e - (nn + ee) * d], 1
    )


def _draw_eddy(rng: Rng, scene: Scene) -> Grow:
    shares = np.exp(rng.uniform(-1.0, 0.0, 3))
    return lambda size: dict(zip(AXES, (size * shares).tolist(), strict=True))


def _draw_hysteresis(rng: Rng, scene: Scene) -> Grow:
    width, sign = (
        float(np.exp(rng.uniform(np.log(30.0), np.log(200.0)))),
        rng.choice([-1.0, 1.0], p=[0.2, 0.8]),
    )
    return lambda size: {"remanence_mgauss": float(sign * size), "width_mgauss": width}


def _act_hysteresis(values: Array, p: Values, scene: Scene, rng: Rng) -> Array:
    """Let domains of four coercivities around the width follow the field with play (Prandtl-Ishlinskii)."""
    every = 4
    widths = p["width_mgauss"] * np.array([0.7, 0.9, 1.1, 1.3])[:, None]
    field = values[::every]
    low, high = field[:, None, :] - widths, field[:, None, :] + widths
    behind = np.empty((len(field), 3))
    state = np.repeat(field[:1], 4, axis=0)
    for row in range(len(field)):
        state = np.minimum(np.maximum(state, low[row]), high[row])
        behind[row] = ((state - field[row]) / widths).mean(axis=0)
    time = scene.motion.time_s
    return values + p["remanence_mgauss"] * np.stack(
        [np.interp(time, time[::every], column) for column in behind.T], axis=1
    )


def _draw_ac(rng: Rng, scene: Scene) -> Grow:
    top = 4.0 if scene.compass.averaged else 0.45 * scene.vehicle.rate_hz
    frequency = float(rng.uniform(0.6, top))
    return grown(
        rng, tuple(f"{wave}_{axis}" for wave in ("sin", "cos") for axis in AXES), frequency_hz=frequency
    )


def _act_ac(values: Array, p: Values, scene: Scene, rng: Rng) -> Array:
    phase = 2.0 * np.pi * p["frequency_hz"] * (scene.start_s + scene.motion.time_s)
    sine, cosine = ([p[f"{wave}_{axis}"] for axis in AXES] for wave in ("sin", "cos"))
    return values + np.outer(np.sin(phase), sine) + np.outer(np.cos(phase), cosine)


FIELDS = (
    Kind("hard_iron", Stage.OUTPUT, along(), lambda v, p, s, r: v + of(p), 20.0, 300.0),
    Kind("hard_iron_step", Stage.OUTPUT, _hard_iron_step, _act_step, 20.0, 600.0),
    Kind("soft_iron", Stage.AMBIENT, along(_PAIRS), _act_soft_iron, 0.03, 0.25),
    Kind("motor_current", Stage.OUTPUT, along(), lambda v, p, s, r: v + np.outer(s.loads.current_a, of(p)),
         1.0, 20.0, frozenset({"loads"})),
    Kind("per_motor", Stage.OUTPUT, _draw_per_motor, _act_per_motor, 20.0, 400.0, frozenset({"loads"})),
    Kind("relay_field", Stage.OUTPUT, _draw_relay,
         lambda v, p, s, r: v + np.outer(_load(s, round(p["source"])) > p["threshold"], of(p)),
         20.0, 200.0, frozenset({"loads"})),
    Kind("temperature_bias", Stage.OUTPUT, lambda r, s: grown(r, reference_degc=reference(r, s)),
         lambda v, p, s, r: v + above(p, s) * of(p), 1.0, 8.0, frozenset({"warming"})),
    Kind("spatial_dipole", Stage.WORLD, _draw_dipole, _act_dipole, 50.0, 8000.0, frozenset({"way"})),
    Kind("field_gradient", Stage.WORLD, along(("nn", "ee", "ne", "nd", "ed")), _act_gradient, 1.0, 60.0,
         frozenset({"way", "near"})),
    Kind("eddy_current", Stage.AMBIENT, _draw_eddy,
         lambda v, p, s, r: v - of(p) * np.gradient(v, STEP_S, axis=0), 0.03, 0.18),
    Kind("hysteresis", Stage.AMBIENT, _draw_hysteresis, _act_hysteresis, 10.0, 60.0),
    Kind("ac_interference", Stage.OUTPUT, _draw_ac, _act_ac, 10.0, 200.0),
)  # fmt: skip


# MAV_SENSOR_ORIENTATION, those that people mount.
_MOUNTINGS = (2, 4, 6, 1, 7, 8, 10, 12, 14, 16, 20, 24, 25)


def _act_non_orthogonality(values: Array, p: Values, scene: Scene, rng: Rng) -> Array:
    x, y, z = values.T
    return np.stack([x, y + p["yx"] * x, z + p["zx"] * x + p["zy"] * y], axis=1)


def _draw_orientation(rng: Rng, scene: Scene) -> Grow:
    number = float(rng.choice(_MOUNTINGS))
    return lambda size: {"orientation": number}


def _act_orientation(values: Array, p: Values, scene: Scene, rng: Rng) -> Array:
    # The sensor's axes in the body are the columns; each measures the field along itself.
    return values @ sensor_orientation_matrix(round(p["orientation"]))


def _draw_temperature_sensitivity(rng: Rng, scene: Scene) -> Grow:
    shares, still = -rng.uniform(0.7, 1.3, 3), reference(rng, scene)
    return lambda size: dict(zip(AXES, (size * shares).tolist(), strict=True)) | {"reference_degc": still}


def _draw_clipping(rng: Rng, scene: Scene) -> Grow:
    top = float(np.abs(scene.plain_mgauss).max())
    return lambda size: {"limit_mgauss": top * (1.0 - size)}


def _act_lag(values: Array, p: Values, scene: Scene, rng: Rng) -> Array:
    time = scene.motion.time_s
    return np.stack([np.interp(time - p["lag_s"], time, column) for column in values.T], axis=1)


def _act_low_pass(values: Array, p: Values, scene: Scene, rng: Rng) -> Array:
    keep = np.exp(-STEP_S / p["time_constant_s"])
    out, _ = scipy.signal.lfilter([1.0 - keep], [1.0, -keep], values, axis=0, zi=keep * values[:1])
    return np.asarray(out)


def _act_cross_axis(values: Array, p: Values, scene: Scene, rng: Rng) -> Array:
    gain = np.ones_like(values)
    for name in _CROSSED:
        gain[:, AXES.index(name[0])] += p[name] * values[:, AXES.index(name[1])] / _GAUSS
    return values * gain


def _act_stale(values: Array, p: Values, scene: Scene, rng: Rng) -> Array:
    fresh = rng.random(len(values)) >= p["fraction"]
    fresh[0] = True
    return values[np.maximum.accumulate(np.where(fresh, np.arange(len(values)), 0))]


ELECTRONICS = (
    Kind("axis_scale", Stage.SENSOR, along(), lambda v, p, s, r: v * (1.0 + of(p)), 0.03, 0.3),
    Kind("non_orthogonality", Stage.SENSOR, along(_BELOW), _act_non_orthogonality, 0.03, 0.15),
    Kind("misalignment", Stage.SENSOR, along(), lambda v, p, s, r: v @ rotvec_to_matrix(of(p)).T, 0.03, 0.3),
    Kind("orientation", Stage.SENSOR, _draw_orientation, _act_orientation, 1.0, 1.0, sized=False),
    Kind("temperature_sensitivity", Stage.SENSOR, _draw_temperature_sensitivity,
         lambda v, p, s, r: v * (1.0 + above(p, s) * of(p)), 0.003, 0.012, frozenset({"warming"})),
    Kind("clipping", Stage.READING, _draw_clipping,
         lambda v, p, s, r: np.clip(v, -p["limit_mgauss"], p["limit_mgauss"]), 0.1, 0.5),
    Kind("transport_lag", Stage.STREAM, only("lag_s"), _act_lag, 0.05, 0.3),
    Kind("low_pass", Stage.STREAM, only("time_constant_s"), _act_low_pass, 0.05, 0.35),
    Kind("cross_axis", Stage.SENSOR, along(_CROSSED), _act_cross_axis, 0.03, 0.15),
    Kind("set_reset_offset", Stage.READING, along(),
         lambda v, p, s, r: v + np.where(np.arange(len(v)) % 2 == 0, 1.0, -1.0)[:, None] * of(p),
         10.0, 100.0, frozenset({"each_row"})),
    Kind("noise_excess", Stage.READING, only("sigma_mgauss"),
         lambda v, p, s, r: v + p["sigma_mgauss"] * r.standard_normal(v.shape), 5.0, 60.0),
    Kind("stale_samples", Stage.READING, only("fraction"), _act_stale, 0.3, 0.9),
    Kind("quantisation", Stage.READING, only("step_mgauss"),
         lambda v, p, s, r: p["step_mgauss"] * np.round(v / p["step_mgauss"]), 10.0, 60.0,
         frozenset({"each_row"})),
)  # fmt: skip
