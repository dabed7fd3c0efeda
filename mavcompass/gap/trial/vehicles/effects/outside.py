"""What no catalogue names, though vehicles do it."""

from __future__ import annotations

import numpy as np
import scipy

from mavcompass.frames import FloatArray as Array
from mavcompass.frames import rotate_back, rotvec_to_matrix
from mavcompass.gap.trial.vehicles.draw import unit
from mavcompass.gap.trial.vehicles.effects.known import AXES, Grow, Kind, Rng, along, dipole, grown, of, only
from mavcompass.gap.trial.vehicles.motion import GRAVITY_NED_MPS2, STEP_S
from mavcompass.gap.trial.vehicles.scene import Scene, Stage, Values

_GAUSS = 1000.0


def _draw_sticking(rng: Rng, scene: Scene) -> Grow:
    axis, spell = float(rng.integers(3)), float(rng.uniform(2.0, 8.0))
    return lambda size: {"axis": axis, "spell_s": spell, "share": size}


def _act_sticking(values: Array, p: Values, scene: Scene, rng: Rng) -> Array:
    out, time = values.copy(), scene.reading_s
    free = p["spell_s"] * (1.0 / p["share"] - 1.0)
    moment, axis = 0.0, round(p["axis"])
    while moment < time[-1]:
        moment += rng.exponential(free)
        first, end = np.searchsorted(time, [moment, moment + p["spell_s"] * rng.uniform(0.7, 1.3)])
        out[first:end, axis] = out[min(first, len(out) - 1), axis]
        moment = float(time[min(end, len(time) - 1)]) + STEP_S
    return out


def _act_flips(values: Array, p: Values, scene: Scene, rng: Rng) -> Array:
    flip = rng.random(len(values)) < STEP_S / p["mean_spell_s"]
    return values + np.outer(np.cumsum(flip) % 2, of(p))


def _act_bursts(values: Array, p: Values, scene: Scene, rng: Rng) -> Array:
    time = scene.motion.time_s
    knots = 0.02 * _walk(rng, int(time[-1]) + 2)
    wander = np.interp(time, np.arange(knots.size), knots)
    turns = np.cumsum(p["frequency_hz"] * (1.0 + wander)) * STEP_S
    start = np.arange(rng.uniform(0.0, p["every_s"]), time[-1], p["every_s"])
    start = start + rng.uniform(-0.2, 0.2, start.size) * p["every_s"]
    gate = np.zeros_like(time)
    for begin, length in zip(start, rng.uniform(0.8, 3.0, start.size), strict=True):
        gate[(time >= begin) & (time < begin + length)] = 1.0
    return values + np.outer(gate * np.sin(2.0 * np.pi * turns), of(p))


def _walk(rng: Rng, count: int) -> Array:
    return np.asarray(scipy.signal.lfilter([0.6], [1.0, -0.8], rng.standard_normal(count)))


def _draw_swinging(rng: Rng, scene: Scene) -> Grow:
    # A load under a line, or on the ground a loose part that hangs and swings.
    length = rng.uniform(1.0, 3.0) if scene.vehicle.kind == "copter" else rng.uniform(0.25, 0.7)
    swing = np.radians(rng.uniform(8.0, 25.0))
    return grown(
        rng, ("moment_forward", "moment_right", "moment_down"), length_m=float(length), swing_rad=float(swing)
    )


def _act_swinging(values: Array, p: Values, scene: Scene, rng: Rng) -> Array:
    """Hang a magnet under the compass: a lightly damped pendulum that gusts and turns keep going."""
    omega, damping = np.sqrt(GRAVITY_NED_MPS2[2] / p["length_m"]), 0.04
    radius, angle = np.exp(-damping * omega * STEP_S), omega * STEP_S
    gusts = rng.standard_normal((len(values), 2))
    swing = scipy.signal.lfilter([1.0], [1.0, -2.0 * radius * np.cos(angle), radius**2], gusts, axis=0)
    swing = p["swing_rad"] * swing / (np.sqrt(2.0) * swing.std())
    hanging = np.column_stack([np.sin(swing), np.sqrt(1.0 - np.minimum((np.sin(swing) ** 2).sum(1), 0.9))])
    # Seen from the magnet the compass is above it.
    apart = -p["length_m"] * rotate_back(scene.motion.rotation, hanging)
    return values + dipole(apart, of(p, ("moment_forward", "moment_right", "moment_down")))


def _act_chirp(values: Array, p: Values, scene: Scene, rng: Rng) -> Array:
    time = scene.motion.time_s
    slope = (p["to_hz"] - p["from_hz"]) / time[-1]
    phase = 2.0 * np.pi * (p["from_hz"] + 0.5 * slope * time) * time
    return values + np.outer(np.sin(phase), of(p))


def _act_current_memory(values: Array, p: Values, scene: Scene, rng: Rng) -> Array:
    keep = np.exp(-STEP_S / p["memory_s"])
    above = scene.loads.current_a - scene.loads.current_a[0]
    return values + np.outer(scipy.signal.lfilter([1.0 - keep], [1.0, -keep], above), of(p))


def _draw_flexing(rng: Rng, scene: Scene) -> Grow:
    way = unit(rng)
    return lambda size: {**dict(zip(AXES, way.tolist(), strict=True)), "rad_per_mps2": size}


def _act_flexing(values: Array, p: Values, scene: Scene, rng: Rng) -> Array:
    """Bend the mast by the force across it: the sensor turns about the level axis square to the force."""
    motion = scene.motion
    force = rotate_back(motion.rotation, motion.acceleration_mps2 - GRAVITY_NED_MPS2)
    bend = np.column_stack([-force[:, 1], force[:, 0], np.zeros(len(force))]) * p["rad_per_mps2"]
    bend = bend * (1.0 + 0.5 * of(p))
    return rotate_back(rotvec_to_matrix(bend), values)


def _act_growing_lag(values: Array, p: Values, scene: Scene, rng: Rng) -> Array:
    time = scene.motion.time_s
    late = time * (1.0 - p["last_lag_s"] / time[-1])
    return np.stack([np.interp(late, time, column) for column in values.T], axis=1)


def _draw_wheel(rng: Rng, scene: Scene) -> Grow:
    return grown(
        rng,
        ("cos_x", "cos_y", "cos_z", "sin_x", "sin_y", "sin_z"),
        circumference_m=float(rng.uniform(0.6, 1.8)),
    )


def _act_wheel(values: Array, p: Values, scene: Scene, rng: Rng) -> Array:
    way = np.cumsum(np.linalg.norm(scene.motion.velocity_mps, axis=1)) * STEP_S
    phase = 2.0 * np.pi * way / p["circumference_m"]
    waves = ([p[f"{wave}_{axis}"] for axis in AXES] for wave in ("cos", "sin"))
    cosine, sine = waves
    return values + np.outer(np.cos(phase), cosine) + np.outer(np.sin(phase), sine)


OUTSIDE = (
    Kind("altitude_offset", Stage.OUTPUT, along(),
         lambda v, p, s, r: v - np.outer(s.motion.position_m[:, 2], of(p)),
         1.0, 20.0, frozenset({"altitude"})),
    Kind("sticking_axis", Stage.READING, _draw_sticking, _act_sticking, 0.2, 0.8),
    Kind("cubic_saturation", Stage.STREAM, only("fraction_at_1_gauss"),
         lambda v, p, s, r: v * (1.0 - p["fraction_at_1_gauss"] * (v / _GAUSS) ** 2), 0.2, 0.8),
    Kind("offset_flips", Stage.OUTPUT,
         lambda r, s: grown(r, mean_spell_s=float(r.uniform(6.0, 25.0))), _act_flips, 20.0, 200.0),
    Kind("speed_gain", Stage.SENSOR, along(),
         lambda v, p, s, r: v * (1.0 + np.linalg.norm(s.motion.velocity_mps, axis=1, keepdims=True) * of(p)),
         0.01, 0.1, frozenset({"way"})),
    Kind("blade_bursts", Stage.OUTPUT,
         lambda r, s: grown(
             r, frequency_hz=float(r.uniform(15.0, 48.0)), every_s=float(r.uniform(6.0, 15.0))),
         _act_bursts, 20.0, 400.0, frozenset({"each_row"})),
    Kind("swinging_load", Stage.AMBIENT, _draw_swinging, _act_swinging, 10.0, 5000.0),
    Kind("chirp", Stage.OUTPUT,
         lambda r, s: grown(r, from_hz=float(r.uniform(0.05, 0.4)), to_hz=float(r.uniform(1.0, 4.0))),
         _act_chirp, 20.0, 200.0),
    Kind("current_memory", Stage.OUTPUT, lambda r, s: grown(r, memory_s=float(r.uniform(8.0, 30.0))),
         _act_current_memory, 2.0, 60.0, frozenset({"loads"})),
    Kind("flexing_mast", Stage.SENSOR, _draw_flexing, _act_flexing, 0.02, 0.2),
    Kind("growing_lag", Stage.STREAM, only("last_lag_s"), _act_growing_lag, 0.2, 1.0),
    Kind("wheel_magnet", Stage.OUTPUT, _draw_wheel, _act_wheel, 20.0, 200.0, frozenset({"wheels"})),
)  # fmt: skip
