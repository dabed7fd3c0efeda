"""The calibration of one vehicle in the simulation: positions as the live procedure observes them, its fit.

The numerical core of the live procedure, without its dialogue: the vehicle stands at each position, tilted
and loaded as in one of its recorded stances, and turns between them; field, gravity and rate pass through its
effects; their means get the errors that the stance was observed with; the same fit as ever gives the
correction, and where its heading is not sure enough, one more position is visited, up to eight.

How wrong the heading then is, where and as the vehicle is used: level, and leaning by 15 degrees.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from mavcompass.calibration.model import ACCELEROMETER
from mavcompass.calibration.observation import Dwell, FourPositionData, Step
from mavcompass.calibration.observation.dwells import TILT_BIAS_SIGMA_RAD
from mavcompass.calibration.observation.turning import GYRO_SCALE_SIGMA
from mavcompass.calibration.positions import FourPositionsResult, solve_four_positions
from mavcompass.correction import FieldCorrection
from mavcompass.frames import FloatArray, euler_to_matrix, rotate, wrap_pi
from mavcompass.gap.rehearsal.draws import GYRO, NOISE, QUANTISATION, TILT, Individual
from mavcompass.gap.rehearsal.kind import Kind, rows_of
from mavcompass.gap.tables import usual
from mavcompass.simulation.effects.effect import Signals
from mavcompass.simulation.physics.signals import Stimulus, ideal

_HZ, _DWELL_ROWS = 10.0, 13
_STEP_ROWS = round(usual.rehearsal.step_s * _HZ)
_HEADINGS, _LEANINGS = 12, 8
_OF_A_MOMENT = ("position_ned_m", "current_a", "throttle", "temperature_degc", "motors")


@dataclass(frozen=True, slots=True)
class Protocol:
    """Say how a calibration is done.

    Attributes:
        positions: on the level; steps of 90 degrees, those beyond four between the first.
        leaning_rad: roll and pitch of further positions, by hand.
        motors_off: without any load. away_m: so far from where the recording was made, north, east, down.
        motor_mgauss: what the correction takes for the motors' field per ampere, raw; None: as in force.
    """

    positions: int = 4
    leaning_rad: tuple[tuple[float, float], ...] = ()
    motors_off: bool = False
    away_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    motor_mgauss: tuple[float, float, float] | None = None


USUAL = Protocol()


def calibrate(kind: Kind, individual: Individual, protocol: Protocol = USUAL) -> FourPositionsResult:
    """Calibrate one vehicle. Raises PoorCalibration where the fit refuses."""
    in_force = corrected_in_force(kind, protocol)
    fit = solve_four_positions(observed(kind, individual, protocol, in_force), in_force, kind.earth)
    if _is_sure(fit) or protocol.leaning_rad:
        return fit
    more = replace(protocol, positions=usual.rehearsal.most_positions)
    most = observed(kind, individual, more, in_force)
    for count in range(protocol.positions + 1, more.positions + 1):
        data = replace(most, dwells=most.dwells[:count], steps=most.steps[: count - 1])
        fit = solve_four_positions(data, in_force, kind.earth)
        if _is_sure(fit):
            break
    return fit


def _is_sure(fit: FourPositionsResult) -> bool:
    """Tell whether the live procedure would ask for no further position."""
    return fit.heading_sigma_rad**2 - fit.budget_rad[ACCELEROMETER] ** 2 <= usual.rehearsal.enough_rad**2


def corrected_in_force(kind: Kind, protocol: Protocol) -> FieldCorrection:
    """Return the correction that a calibration starts from, with the protocol's motor compensation."""
    if protocol.motor_mgauss is None:
        return kind.iron.correction
    x, y, z = (-kind.iron.correction.matrix @ np.array(protocol.motor_mgauss)).tolist()
    return replace(kind.iron.correction, motor_mgauss=(x, y, z), motor_source="current")


def loads(stimulus: Stimulus, correction: FieldCorrection) -> FloatArray:
    """Return what the motors' field goes with, (N,): the throttle if the correction says so."""
    return stimulus.throttle if correction.motor_source == "throttle" else stimulus.current_a


def observed(
    kind: Kind, individual: Individual, protocol: Protocol, in_force: FieldCorrection
) -> FourPositionData:
    """Let a vehicle visit its positions; return them as the calibration observes them."""
    count = protocol.positions + len(protocol.leaning_rad)
    stimulus = _motion(kind, individual, protocol, count)
    chain = individual.chain(loads(stimulus, kind.iron.correction))
    said = chain.run(Signals(stimulus, ideal(stimulus)), None).reading
    # The compensation in force stays in what a calibration sees.
    compensated = np.linalg.solve(in_force.matrix, in_force.motor_field(loads(stimulus, in_force)).T).T
    vertical = np.einsum("ij,ij->i", stimulus.rotation[:, 2, :], said.gyro_radps)
    *steps_off, scale, bias = individual.chances[GYRO].tolist()
    turned = np.concatenate([[0.0], np.cumsum(0.5 * (vertical[1:] + vertical[:-1])) / _HZ])
    dwells, middles = [], []
    for k in range(count):
        rows = slice(k * _STEP_ROWS, k * _STEP_ROWS + _DWELL_ROWS)
        field = (said.mag_mgauss + compensated)[rows].mean(axis=0)
        force, current = said.acc_mps2[rows].mean(axis=0), float(stimulus.current_a[rows].mean())
        dwells.append(_dwell(kind, individual, k, field, force, current))
        middles.append(float(turned[rows].mean()))
    walk_rad = kind.turns.walk_rad * math.sqrt(usual.rehearsal.step_s)
    steps, bias_sigma = [], kind.turns.bias_sigma_radps
    for k, turn in enumerate(np.diff(middles).tolist()):
        sigma = math.hypot(walk_rad, dwells[k].turned_sigma_rad, dwells[k + 1].turned_sigma_rad)
        drifted = bias * bias_sigma * usual.rehearsal.step_s + sigma * steps_off[k]
        told = (1.0 + scale * GYRO_SCALE_SIGMA) * turn + drifted
        steps.append(Step(told, sigma, usual.rehearsal.step_s))
    return FourPositionData(tuple(dwells), tuple(steps), GYRO_SCALE_SIGMA, bias_sigma, TILT_BIAS_SIGMA_RAD)


def _dwell(
    kind: Kind, individual: Individual, k: int, field_mgauss: FloatArray, force: FloatArray, current_a: float
) -> Dwell:
    """Observe one position with the errors of one of the vehicle's stances."""
    stance, chances = kind.stances[individual.stance[k]], individual.chances
    noise = np.linalg.cholesky(stance.covariance_mgauss2 + 1e-9 * np.eye(3)) @ chances[NOISE][k]
    whole = np.linalg.cholesky(stance.quantisation_mgauss2 + 1e-9 * np.eye(3)) @ chances[QUANTISATION][k]
    tilt = stance.tilt_sigma_rad * chances[TILT][k] + TILT_BIAS_SIGMA_RAD * chances[TILT][-1]
    x, y, z = force.tolist()
    return replace(
        stance,
        mean_mgauss=field_mgauss + noise + whole,
        roll_rad=math.atan2(-y, -z) + float(tilt[0]),
        pitch_rad=math.atan2(x, math.hypot(y, z)) + float(tilt[1]),
        swing=np.eye(3),
        current_a=current_a,
        unsteady_mgauss=0.0,
    )


def _motion(kind: Kind, individual: Individual, protocol: Protocol, count: int) -> Stimulus:
    """Stand, turn by a profile of least jerk, stand again: rows at 10 Hz."""
    n = (count - 1) * _STEP_ROWS + _DWELL_ROWS
    level = protocol.positions
    even = np.array([k if k < 4 else k - 0.5 for k in range(level)] + [*range(level, count)])
    heading = individual.heading_rad + 0.5 * math.pi * even + individual.turned_off_rad[:count]
    stances = [kind.stances[i] for i in individual.stance[:count]]
    roll = np.array([stance.roll_rad for stance in stances])
    pitch = np.array([stance.pitch_rad for stance in stances])
    for k, (lean_roll, lean_pitch) in enumerate(protocol.leaning_rad, level):
        roll[k], pitch[k] = lean_roll, lean_pitch
    position, since = np.divmod(np.arange(n), _STEP_ROWS)
    after = np.minimum(position + 1, count - 1)
    share = np.clip((since - _DWELL_ROWS + 1) / (_STEP_ROWS - _DWELL_ROWS + 1), 0.0, 1.0)
    way = share**3 * (10.0 + share * (6.0 * share - 15.0))
    speed = 30.0 * (share * (1.0 - share)) ** 2 * _HZ / (_STEP_ROWS - _DWELL_ROWS + 1)
    turn = heading[after] - heading[position]

    def between(values: FloatArray) -> FloatArray:
        return values[position] + way * (values[after] - values[position])

    rotation = euler_to_matrix(between(roll), between(pitch), between(heading))
    turning = rotation[:, 2, :] * (turn * speed)[:, np.newaxis]
    where = np.where(since < _DWELL_ROWS, position, after)
    at = individual.stance[:count][where]
    load = 0.0 if protocol.motors_off else 1.0
    start_s = float(kind.used.time_s[-1]) + usual.rehearsal.afterwards_s
    return Stimulus.posed(
        start_s + np.arange(n) / _HZ,
        rotation,
        individual.field_ned_mgauss,
        rate_radps=turning,
        position_ned_m=kind.still.position_ned_m[at] + np.array(protocol.away_m),
        current_a=kind.still.current_a[at] * load,
        throttle=kind.still.throttle[at] * load,
        temperature_degc=kind.still.temperature_degc[at],
        motors=kind.still.motors[at] * load,
    )


def _attitudes() -> tuple[FloatArray, FloatArray]:
    """Return yaw (N,) and roll and pitch (N, 2): the circle level first, then leaning in eight directions."""
    lean = np.arange(_LEANINGS) * (2.0 * math.pi / _LEANINGS)
    tilts = np.vstack(
        [np.zeros((1, 2)), usual.rehearsal.leaning_rad * np.stack([np.cos(lean), np.sin(lean)], axis=1)]
    )
    yaw = np.tile(np.arange(_HEADINGS) * (2.0 * math.pi / _HEADINGS), len(tilts))
    return yaw, np.repeat(tilts, _HEADINGS, axis=0)


_YAW, _TILT = _attitudes()
_ROTATION = euler_to_matrix(_TILT[:, 0], _TILT[:, 1], _YAW)
_LEVELLING = euler_to_matrix(_TILT[:, 0], _TILT[:, 1], 0.0)


def heading_errors_deg(
    kind: Kind, individual: Individual, correction: FieldCorrection
) -> tuple[float, float]:
    """Return the rms heading error over the circle, level and at 15 degrees of tilt in all directions.

    The reading is free of noise, tilt and declination are known exactly; load, temperature and place are
    those of a moment of the recording.
    """
    each, field = usual.rehearsal.readings, individual.field_ned_mgauss
    n = _YAW.size * each
    moment = rows_of(kind.used, np.full(n, individual.used))
    stimulus = Stimulus.posed(
        kind.used.time_s[-1] + usual.rehearsal.much_later_s + usual.rehearsal.held_s * np.arange(n),
        np.repeat(_ROTATION, each, axis=0),
        field,
        **{name: getattr(moment, name) for name in _OF_A_MOMENT},
    )
    chain = individual.chain(loads(stimulus, kind.iron.correction))
    raw = chain.run(Signals(stimulus, ideal(stimulus)), None).reading.mag_mgauss[each - 1 :: each]
    load = None if correction.motor_source == "none" else loads(stimulus, correction)[each - 1 :: each]
    level = rotate(_LEVELLING, correction.apply(raw, load))
    declination = math.atan2(field[1], field[0])
    error = wrap_pi(np.arctan2(-level[:, 1], level[:, 0]) + declination - _YAW)
    square = np.degrees(error) ** 2
    return math.sqrt(float(square[:_HEADINGS].mean())), math.sqrt(float(square[_HEADINGS:].mean()))
