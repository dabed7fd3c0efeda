"""How the vehicles move: on the ground, on water, in the air, in a person's hands.

Every motion is made on an even grid of 100 Hz: a course and a speed, smoothed as masses are, then the
attitude that goes with them (slopes, waves, leaning, tilting for thrust).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mavcompass.frames import FloatArray as Array
from mavcompass.frames import euler_to_matrix, matrix_to_euler, matrix_to_rotvec

STEP_S = 0.01
GRAVITY_NED_MPS2 = np.array([0.0, 0.0, 9.80665])
ON_THE_WAY = ("lanes", "wander", "figure_eight", "circles")
MOTIONS: dict[str, tuple[str, ...]] = {
    "rover": (*ON_THE_WAY, "four_positions", "pirouette", "hand"),
    "ackermann-rover": (*ON_THE_WAY, "four_positions"),
    "boat": (*ON_THE_WAY, "four_positions"),
    "copter": (*ON_THE_WAY, "four_positions", "hand"),
}
_SPEED_MPS = {"rover": (0.6, 2.5), "ackermann-rover": (1.5, 5.0), "boat": (1.0, 3.5), "copter": (2.0, 8.0)}
_TURN_RADPS = {"rover": (0.4, 1.1), "ackermann-rover": (0.3, 0.8), "boat": (0.15, 0.5), "copter": (0.3, 0.9)}


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Hold a motion at N even steps from time 0.

    Attributes:
        name: one of `MOTIONS`.
        time_s: (N,).
        rotation: NED <- FRD, (N, 3, 3); rate_radps: (N, 3) in body axes.
        position_m, velocity_mps, acceleration_mps2: NED, (N, 3), from the place of departure.
    """

    name: str
    time_s: Array
    rotation: Array
    rate_radps: Array
    position_m: Array
    velocity_mps: Array
    acceleration_mps2: Array


def move(kind: str, name: str, duration_s: float, rng: np.random.Generator) -> Motion:
    """Make a motion of a kind of vehicle."""
    time: Array = np.arange(round(duration_s / STEP_S) + 1, dtype=np.float64) * STEP_S
    if name == "hand":
        rotation, position = _hand(time, rng)
        velocity = np.gradient(position, STEP_S, axis=0)
    else:
        speed, turn = _plan(kind, name, time, rng)
        course = rng.uniform(-np.pi, np.pi) + np.cumsum(turn) * STEP_S
        velocity = np.stack([speed * np.cos(course), speed * np.sin(course), np.zeros_like(time)], axis=1)
        if kind == "boat":
            velocity[:, :2] += rng.normal(0.0, 0.12, 2)
        if kind == "copter":
            velocity[:, 2] = -_climb(name, time, rng)
            velocity += _wobble(time, rng, 3, 4.0) * np.array([0.12, 0.12, 0.06])
        position = np.cumsum(velocity, axis=0) * STEP_S
        if kind == "copter":
            position[:, 2] -= rng.uniform(3.0, 15.0)
        pull = np.gradient(velocity, STEP_S, axis=0)
        rotation = {"copter": _flying, "boat": _afloat}.get(kind, _rolling)(
            time, course, speed, velocity, pull, rng
        )
    return Motion(
        name=name,
        time_s=time,
        rotation=rotation,
        rate_radps=_body_rates(rotation, STEP_S),
        position_m=position,
        velocity_mps=velocity,
        acceleration_mps2=np.gradient(velocity, STEP_S, axis=0),
    )


def smooth(values: Array, width_s: float) -> Array:
    """Average values (N,) at 100 Hz over a bell of a width; the ends are held."""
    half = max(2, round(width_s / STEP_S))
    bell = np.hanning(2 * half + 1)
    padded = np.pad(values, half, mode="edge")
    return np.convolve(padded, bell / bell.sum(), mode="valid")


def _wobble(time: Array, rng: np.random.Generator, columns: int, period_s: float) -> Array:
    """Return unit-variance irregular swinging (N, columns) around a period."""
    out = np.zeros((time.size, columns))
    for column in range(columns):
        for frequency in np.exp(rng.uniform(-0.6, 0.6, 7)) / period_s:
            out[:, column] += np.sin(2.0 * np.pi * (frequency * time + rng.random()))
    return out * np.sqrt(2.0 / 7.0)


def _segments(time: Array, pieces: list[tuple[float, float]]) -> Array:
    """Repeat pieces (seconds, value) over the time as steps (N,)."""
    lengths, values = (np.array(column) for column in zip(*pieces, strict=True))
    rounds = int(np.ceil((time[-1] + 1.0) / lengths.sum()))
    edges = np.cumsum(np.tile(lengths, rounds))
    return np.tile(values, rounds)[np.minimum(np.searchsorted(edges, time, side="right"), edges.size - 1)]


def _plan(kind: str, name: str, time: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Draw speed (N,) and turn rate (N,) over time."""
    top = float(np.exp(rng.uniform(*np.log(_SPEED_MPS[kind]))))
    turn = rng.uniform(*_TURN_RADPS[kind])
    if kind == "ackermann-rover":
        turn = min(turn, top / 2.0)
    side = rng.choice([-1.0, 1.0])
    quarter = 0.5 * np.pi / turn
    steady = [(time[-1] + 10.0, top)]
    if name == "lanes":
        leg = rng.uniform(6.0, 18.0)
        turns = [(leg, 0.0), (2.0 * quarter, side * turn), (leg, 0.0), (2.0 * quarter, -side * turn)]
        crossing = rng.uniform(0.0, 0.25) * turn
        speeds, turns = steady, [*turns, (leg, 0.0), (quarter, side * turn), (leg, crossing)]
    elif name == "circles":
        around = rng.uniform(1.0, 3.0) * 4.0 * quarter
        speeds, turns = steady, [(around, side * turn), (around, -side * turn)]
    elif name == "figure_eight":
        speeds, turns = steady, [(4.0 * quarter, side * turn), (4.0 * quarter, -side * turn)]
    elif name == "wander":
        speeds = [(rng.uniform(4.0, 15.0), top * rng.choice([0.0, 0.5, 0.8, 1.0])) for _ in range(60)]
        turns = [(rng.uniform(1.5, 8.0), rng.choice([-1.0, 0.0, 0.0, 1.0]) * turn) for _ in range(120)]
    elif name == "pirouette":
        spin = rng.uniform(0.5, 1.5)
        turns = [(rng.uniform(5.0, 12.0), spin), (2.0, 0.0), (rng.uniform(5.0, 12.0), -spin), (3.0, 0.0)]
        speeds = [(10.0, 0.0)]
    elif kind == "ackermann-rover":
        dwell = rng.uniform(5.0, 9.0)
        turns = [(dwell, 0.0), (quarter, side * turn)]
        speeds = [(dwell - 1.0, 0.0), (quarter + 1.0, top)]
    else:
        turns = [
            piece
            for _ in range(4)
            for piece in ((rng.uniform(5.0, 9.0), 0.0), (quarter * rng.uniform(0.9, 1.1), side * turn))
        ]
        speeds = [(10.0, 0.0)]
    width = {"boat": 1.5, "copter": 0.8}.get(kind, 0.4)
    speed = smooth(_segments(time, speeds), 2.0 * width) * (1.0 + 0.03 * _wobble(time, rng, 1, 6.0)[:, 0])
    rate = smooth(_segments(time, turns), width)
    if kind == "ackermann-rover":
        # Wheels that do not roll do not turn the car.
        rate = np.clip(rate, -speed / 1.5, speed / 1.5)
    jitter = {"boat": 0.02, "copter": 0.02}.get(kind, 0.01) * _wobble(time, rng, 1, 2.5)[:, 0]
    return speed, rate + jitter * (1.0 if kind in ("boat", "copter") else np.minimum(speed, 1.0))


def _climb(name: str, time: Array, rng: np.random.Generator) -> Array:
    """Draw a climb rate (N,): up and down by some metres, or none while hovering."""
    if name == "four_positions":
        return np.zeros_like(time)
    climb, pause = rng.uniform(0.5, 2.0), rng.uniform(4.0, 12.0)
    length = rng.uniform(3.0, 8.0)
    return smooth(_segments(time, [(pause, 0.0), (length, climb), (pause, 0.0), (length, -climb)]), 1.0)


def _flying(
    time: Array, course: Array, speed: Array, velocity: Array, pull: Array, rng: np.random.Generator
) -> Array:
    wind = np.append(rng.normal(0.0, 2.0, 2), 0.0)
    drag = rng.uniform(0.15, 0.35) * (velocity - wind)
    thrust = pull - GRAVITY_NED_MPS2 + drag
    thrust = np.stack([smooth(column, 0.12) for column in thrust.T], axis=1)
    shake = _wobble(time, rng, 2, 0.9) * np.radians(rng.uniform(0.2, 0.8))
    thrust[:, :2] += 9.8 * shake
    nose = course if rng.random() < 0.7 else course + rng.uniform(-np.pi, np.pi)
    return _from_thrust(thrust, nose + np.radians(0.5) * _wobble(time, rng, 1, 3.0)[:, 0])


def _afloat(
    time: Array, course: Array, speed: Array, velocity: Array, pull: Array, rng: np.random.Generator
) -> Array:
    period = rng.uniform(2.0, 5.0)
    waves = _wobble(time, rng, 2, period) * np.radians([rng.uniform(1.5, 7.0), rng.uniform(0.7, 2.5)])
    sideways = pull[:, 1] * np.cos(course) - pull[:, 0] * np.sin(course)
    roll = waves[:, 0] - rng.uniform(0.0, 0.6) * sideways / 9.8
    pitch = waves[:, 1] + np.radians(rng.uniform(0.0, 3.0)) * speed / max(float(speed.max()), 0.5)
    return euler_to_matrix(roll, pitch, course + np.radians(1.0) * _wobble(time, rng, 1, period)[:, 0])


def _rolling(
    time: Array, course: Array, speed: Array, velocity: Array, pull: Array, rng: np.random.Generator
) -> Array:
    """Follow ground whose slopes belong to the place, on springs."""
    slope = np.radians(rng.choice([0.15, 1.0, 3.0]))
    place = np.cumsum(velocity[:, :2], axis=0) * STEP_S
    rise = np.tile(0.5 * slope * rng.standard_normal(2), (time.size, 1))
    for length in np.exp(rng.uniform(np.log(3.0), np.log(40.0), 6)):
        toward = rng.uniform(0.0, 2.0 * np.pi)
        direction = np.array([np.cos(toward), np.sin(toward)])
        phase = 2.0 * np.pi * (place @ direction / length + rng.random())
        rise += 0.5 * slope * np.cos(phase)[:, None] * direction
    c, s = np.cos(course), np.sin(course)
    sideways, ahead = pull[:, 1] * c - pull[:, 0] * s, pull[:, 0] * c + pull[:, 1] * s
    bumps = _wobble(time, rng, 2, 0.5) * 0.3 * slope * np.minimum(speed, 1.0)[:, None]
    spring = rng.uniform(0.0, 0.03)
    pitch = rise[:, 0] * c + rise[:, 1] * s + bumps[:, 0] + spring * ahead
    roll = rise[:, 0] * s - rise[:, 1] * c + bumps[:, 1] - spring * sideways
    return euler_to_matrix(roll, pitch, course)


def _hand(time: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Turn through all attitudes, as a person does who holds the vehicle."""
    roll_rate, yaw_rate = (rng.choice([-1.0, 1.0], 2) * rng.uniform(0.25, 0.7, 2)).tolist()
    sway = _wobble(time, rng, 3, 10.0)
    roll = rng.uniform(-3.0, 3.0) + roll_rate * time + 0.5 * sway[:, 0]
    pitch = 0.85 * np.tanh(sway[:, 1]) + 0.3 * np.sin(0.31 * time)
    yaw = rng.uniform(-3.0, 3.0) + yaw_rate * time + 0.4 * sway[:, 2]
    position = 0.08 * _wobble(time, rng, 3, 2.0) + np.array([0.0, 0.0, -1.2])
    return euler_to_matrix(roll, pitch, yaw), position


def _from_thrust(thrust_ned: Array, yaw_rad: Array) -> Array:
    """Build rotations (N, 3, 3) with down against a thrust (N, 3) and the nose toward a yaw (N,)."""
    down = -thrust_ned / np.linalg.norm(thrust_ned, axis=1, keepdims=True)
    level = np.stack([np.cos(yaw_rad), np.sin(yaw_rad), np.zeros_like(yaw_rad)], axis=1)
    right = np.cross(down, level)
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    return np.stack([np.cross(right, down), right, down], axis=2)


def _body_rates(rotation: Array, step_s: float) -> Array:
    """Differentiate rotations (N, 3, 3) at equal steps: the angular rate (N, 3) in body axes, rad/s."""
    between = np.swapaxes(rotation[:-1], 1, 2) @ rotation[1:]
    middle = matrix_to_rotvec(between) / step_s
    padded = np.concatenate([middle[:1], middle, middle[-1:]])
    return 0.5 * (padded[:-1] + padded[1:])


def angles(rotation: Array) -> Array:
    """Read roll, pitch and yaw (N, 3) off rotations (N, 3, 3)."""
    return np.stack(matrix_to_euler(rotation), axis=1)
