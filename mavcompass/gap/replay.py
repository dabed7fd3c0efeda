"""Replay a recording through the simulation: its own inputs in, the nominal readings out.

The calibration in force is undone first; the field is the world model's; what a healthy autopilot does
to a reading (ten readings a second, averaged, repeated, late) belongs to the replay, not to the gap.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mavcompass.earth_field import decimal_year, earth_field
from mavcompass.errors import BadRecording
from mavcompass.frames import FloatArray, rotate, rotate_back, wrap_pi
from mavcompass.gap.nuisance import REFERENCE_YAW, WORLD_FIELD, Nuisance, telemetry_age
from mavcompass.gap.reference import Choice, Reference, reference_attitude
from mavcompass.simulation.effects.effect import Group, Signals
from mavcompass.simulation.signals import Reading, Stimulus
from mavcompass.track import MagSeries, Series, Track
from mavcompass.units import STANDARD_GRAVITY_MPS2

_FEWEST_ROWS = 60
_MOST_ROWS = 4_000
_UNKNOWN_FIELD_SIGMA_MGAUSS = 300.0
_COMPASS_PERIOD_S = 0.1
_LOCAL_SIGMA_MGAUSS = 0.7
_STEADY_MGAUSS = 3.0
_AGREES_MGAUSS = 8.0
_UNKNOWN_MOTION_MPS2 = 0.3
_TURNING_RAD = math.radians(25.0)
_TILT_RAD = math.radians(4.0)
# What a load must at least vary by to be told from everything else that happens meanwhile.
_LEAST_RANGE = {"current": 0.5, "throttle": 0.05, "temperature": 3.0}
# Motors that turn both ways stand still at half of their output.
_NEUTRAL_IN_THE_MIDDLE = frozenset({"rover", "ackermann-rover", "boat", "sub"})
_YEAR_WHERE_UNKNOWN = 2026.5
_NO_TURN = (
    "The vehicle hardly turns: a constant offset cannot be told from the field, so that it counts as the"
    " field's."
)


@dataclass(frozen=True, slots=True, eq=False)
class Replay:
    """Hold the nominal simulation of a recording beside what was measured.

    Attributes:
        signals: the inputs, and what ideal sensors would have said.
        measured: what the sensors said, the calibration in force undone, (N, 3) each.
        valid: rows with a reading and a reference, (N,).
        groups: the sensors that can be compared: the compass always, accelerometer and gyro where the
            reference did not come from them.
        nuisances: what must be solved for besides any effect.
        present: what the recording contains of the needs of effects.
        reference: where the attitude comes from.
        resolution_mgauss: the noise that the numbers' steps alone make.
        telemetry: True where readings are repeated and late by the autopilot's nature.
        field_known: True where the world model gave the field.
        notes: what a reader of the result must know.
    """

    signals: Signals
    measured: Reading
    valid: NDArray[np.bool_]
    groups: tuple[Group, ...]
    nuisances: tuple[Nuisance, ...]
    present: frozenset[str]
    reference: Reference
    resolution_mgauss: float
    telemetry: bool
    field_known: bool
    notes: tuple[str, ...]

    @property
    def time_s(self) -> FloatArray:
        """Return the times of the rows, (N,)."""
        return self.signals.stimulus.time_s


def replay(track: Track, instance: int = 1, choice: Choice = "auto") -> Replay:
    """Build the nominal simulation of one compass of a recording.

    Raises BadRecording where there is no such compass, or too little to compare.
    """
    compass = _compass(track, instance)
    time_s, keep = np.unique(compass.time_s, return_index=True)
    raw = _raw_field(track, compass)[keep]
    if time_s.size < _FEWEST_ROWS:
        raise BadRecording(
            f"{track.source or 'The recording'} has {time_s.size} readings of compass {instance}, too few.",
            "Record at least half a minute of turning.",
        )
    reference = reference_attitude(track, time_s, choice)
    hold = _hold(time_s, compass.reported.values[keep], track.autopilot)
    thinned = _stride(time_s.size)
    if thinned > 1:
        # Averages of an odd number of neighbours, at the time of the middle one.
        raw = _averaged(raw, thinned)
        rows = slice(thinned // 2, time_s.size - thinned // 2, thinned)
        time_s, raw, hold = time_s[rows], raw[rows], None if hold is None else hold[rows]
        reference = replace(
            reference,
            rotation=reference.rotation[rows],
            rate_radps=reference.rate_radps[rows],
            known=reference.known[rows],
        )
    field, sigma, field_notes = _world_field(track, instance, time_s, reference, raw)
    stimulus = _stimulus(track, time_s, reference, field)
    acc = _column(track.acc_mps2, time_s, thinned)
    gyro = _column(track.gyro_radps, time_s, thinned)
    measured = Reading(raw, acc, gyro)
    stimulus = _with_linear_acceleration(stimulus, acc, reference)
    ideal = Reading(
        rotate_back(stimulus.rotation, stimulus.field_ned_mgauss),
        stimulus.specific_force_mps2,
        stimulus.rate_radps,
    )
    independent = reference.kind == "columns"
    present = _present(track, stimulus, independent, reference.known & np.isfinite(raw).all(axis=1))
    if "turning" not in present:
        # A constant offset in body axes is then a constant field: its size can be anything.
        sigma = np.maximum(sigma, _UNKNOWN_FIELD_SIGMA_MGAUSS)
        field_notes = (*field_notes, _NO_TURN)
    groups: tuple[Group, ...] = ("mag",)
    valid = reference.known & np.isfinite(raw).all(axis=1)
    inertial: tuple[tuple[Group, FloatArray], ...] = (("acc", acc), ("gyro", gyro))
    motion_note: tuple[str, ...] = ()
    for name, values in inertial:
        if independent and np.isfinite(values[valid]).all() and np.abs(values).sum() > 0.0:
            off = np.median(np.abs(values - (ideal.acc_mps2 if name == "acc" else ideal.gyro_radps))[valid])
            if name == "acc" and off > _UNKNOWN_MOTION_MPS2:
                motion_note = ("The accelerometer feels motion that the recording does not tell: left out.",)
                continue
            groups = (*groups, name)
    return Replay(
        signals=Signals(stimulus, ideal),
        measured=measured,
        valid=valid,
        groups=groups,
        nuisances=_nuisances(reference, stimulus, raw, sigma, hold, valid),
        present=present,
        reference=reference,
        resolution_mgauss=compass.quantum_mgauss / math.sqrt(12.0),
        telemetry=hold is not None,
        field_known=sigma[0] < _UNKNOWN_FIELD_SIGMA_MGAUSS,
        notes=(*track.notes, *reference.notes, *field_notes, *motion_note),
    )


def _compass(track: Track, instance: int) -> MagSeries:
    if instance not in track.compasses:
        have = ", ".join(str(i) for i in sorted(track.compasses)) or "none"
        raise BadRecording(
            f"{track.source or 'The recording'} has no compass {instance} (it has {have}).",
            "Choose one of them with --compass.",
        )
    return track.compasses[instance]


def _raw_field(track: Track, compass: MagSeries) -> FloatArray:
    """Undo the calibration in force; where the numbers were cut toward zero, put the mean half step back."""
    if compass.truncated and compass.quantum_mgauss > 0.0:
        values = compass.reported.values
        restored = Series.of(compass.time_s, values + 0.5 * compass.quantum_mgauss * np.sign(values))
        compass = replace(compass, reported=restored)
        track = replace(track, compasses={**track.compasses, compass.instance: compass})
    return track.raw_field(compass.instance)


def _stride(count: int) -> int:
    """Return how many neighbours are averaged so that at most _MOST_ROWS remain: an odd number."""
    stride = math.ceil(count / _MOST_ROWS)
    return stride + 1 if stride > 1 and stride % 2 == 0 else stride


def _averaged(values: FloatArray, width: int) -> FloatArray:
    """Return centred running means of columns (N, k); the ends are held."""
    half = width // 2
    padded = np.pad(values, ((half, half), (0, 0)), mode="edge")
    total = np.vstack([np.zeros((1, values.shape[1])), np.cumsum(padded, axis=0)])
    return np.asarray((total[width:] - total[:-width]) / width)


def _column(series: Series | None, time_s: FloatArray, averaged: int = 1) -> FloatArray:
    if series is None or len(series) < 2:
        return np.full((time_s.size, 3), np.nan)
    if averaged > 1 and np.isfinite(series.values).all():
        series = Series.of(series.time_s, _averaged(series.values, averaged))
    return np.ascontiguousarray(series.at(time_s))


def _scalar(series: Series | None, time_s: FloatArray) -> FloatArray:
    if series is None or not np.isfinite(series.values).any():
        return np.full(time_s.size, np.nan)
    finite = np.isfinite(series.values)
    return np.interp(time_s, series.time_s[finite], series.values[finite])


def _world_field(
    track: Track, instance: int, time_s: FloatArray, reference: Reference, raw: FloatArray
) -> tuple[FloatArray, FloatArray, tuple[str, ...]]:
    """Return the field in NED, its sigma, and what to say about it."""
    if track.place is not None and np.isfinite(track.place.values).all(axis=1).any():
        place = track.place.values[np.isfinite(track.place.values).all(axis=1)]
        lat, lon, alt = np.median(place, axis=0).tolist()
        year = decimal_year(track.utc_offset_s) if track.utc_offset_s else _YEAR_WHERE_UNKNOWN
        earth = earth_field(round(lat, 5), round(lon, 5), round(alt, 1), round(year, 3))
        refined = _measured_by_others(track, instance, time_s, reference, earth.vector_mgauss)
        if refined is not None:
            note = "The vehicle's other compasses agree with the world model; they give the local field."
            return (
                refined,
                np.array([_LOCAL_SIGMA_MGAUSS, earth.sigma_mgauss[1], _LOCAL_SIGMA_MGAUSS]),
                (note,),
            )
        return earth.vector_mgauss, np.array(earth.sigma_mgauss), ()
    rows = reference.known & np.isfinite(raw).all(axis=1)
    if not rows.any():
        raise BadRecording("The attitude reference and the compass never speak at the same time.", "")
    field = np.median(rotate(reference.rotation[rows], raw[rows]), axis=0)
    note = (
        "The recording does not say where it was made: the field is estimated from it, so that the field's"
        " intensity, inclination and declination cannot be judged."
    )
    return field, np.full(3, _UNKNOWN_FIELD_SIGMA_MGAUSS), (note,)


def _measured_by_others(
    track: Track, instance: int, time_s: FloatArray, reference: Reference, model: FloatArray
) -> FloatArray | None:
    """Return the local field as at least two other, calibrated compasses measure it.

    They count where each sees a constant field and its level and vertical parts agree with the model's;
    the declination stays the model's, since yaw may come from a compass.
    """
    seen = []
    level = float(np.hypot(model[0], model[1]))
    for number, compass in track.compasses.items():
        if number == instance or not compass.correction_known or len(compass.reported) < _FEWEST_ROWS:
            continue
        values = compass.reported.values + 0.5 * compass.quantum_mgauss * compass.truncated * np.sign(
            compass.reported.values
        )
        world = rotate(
            reference.rotation[reference.known], Series.of(compass.time_s, values).at(time_s)[reference.known]
        )
        parts = np.array([np.median(np.hypot(world[:, 0], world[:, 1])), np.median(world[:, 2])])
        spread = 1.4826 * np.median(np.abs(np.hypot(world[:, 0], world[:, 1]) - parts[0]))
        if spread < _STEADY_MGAUSS and np.abs(parts - (level, model[2])).max() < _AGREES_MGAUSS:
            seen.append(parts)
    if len(seen) < 2 or float(np.ptp(np.array(seen), axis=0).max()) > 2.0 * _LOCAL_SIGMA_MGAUSS:
        return None
    horizontal, down = np.mean(seen, axis=0)
    return np.array([model[0] * horizontal / level, model[1] * horizontal / level, down])


def _stimulus(track: Track, time_s: FloatArray, reference: Reference, field: FloatArray) -> Stimulus:
    n = time_s.size
    motors = np.empty((n, 0))
    if track.motors is not None and len(track.motors) > 1:
        motors = np.nan_to_num(track.motors.at(time_s))
        if track.vehicle in _NEUTRAL_IN_THE_MIDDLE:
            motors = 2.0 * np.abs(motors - 0.5)
    position = _column(track.position_ned_m, time_s)
    return Stimulus(
        time_s=time_s,
        rotation=reference.rotation,
        field_ned_mgauss=np.tile(field, (n, 1)),
        rate_radps=reference.rate_radps,
        specific_force_mps2=reference.rotation[:, 2, :] * -STANDARD_GRAVITY_MPS2,
        position_ned_m=position,
        velocity_ned_mps=_column(track.gps_velocity_mps, time_s),
        current_a=_scalar(track.current_a, time_s),
        throttle=_scalar(track.throttle, time_s),
        temperature_degc=_scalar(track.temperature_degc, time_s),
        motors=motors,
    )


def _with_linear_acceleration(stimulus: Stimulus, acc: FloatArray, reference: Reference) -> Stimulus:
    """Add the acceleration of the recorded path, where that explains the accelerometer better."""
    position = stimulus.position_ned_m
    known = np.isfinite(position).all(axis=1) & np.isfinite(acc).all(axis=1) & reference.known
    if reference.kind != "columns" or known.sum() < 0.9 * len(position):
        return stimulus
    from scipy.signal import savgol_filter

    step = float(np.median(np.diff(stimulus.time_s)))
    window = max(5, 2 * round(0.08 / step) + 1)
    path = np.stack(
        [np.interp(stimulus.time_s, stimulus.time_s[known], p[known]) for p in position.T], axis=1
    )
    linear = savgol_filter(path, window, 3, deriv=2, delta=step, axis=0)
    moving = stimulus.specific_force_mps2 + rotate_back(stimulus.rotation, linear)
    at_rest_error = np.median(np.abs(acc - stimulus.specific_force_mps2)[known])
    moving_error = np.median(np.abs(acc - moving)[known])
    return replace(stimulus, specific_force_mps2=moving) if moving_error < 0.9 * at_rest_error else stimulus


def _hold(time_s: FloatArray, reported: FloatArray, autopilot: str) -> FloatArray | None:
    """Return how long each row has repeated the one before, where an autopilot's telemetry does so."""
    if autopilot == "unknown" or time_s.size < 3:
        return None
    repeated = np.concatenate([[False], (np.diff(reported, axis=0) == 0.0).all(axis=1)])
    fresh_at = np.maximum.accumulate(np.where(repeated, -1, np.arange(time_s.size)))
    hold = time_s - time_s[np.maximum(fresh_at, 0)]
    # Longer than the firmware's period it is a vehicle at rest, not an old value.
    return np.minimum(hold, _COMPASS_PERIOD_S - 1e-3)


def _nuisances(
    reference: Reference,
    stimulus: Stimulus,
    raw: FloatArray,
    field_sigma: FloatArray,
    hold: FloatArray | None,
    valid: NDArray[np.bool_],
) -> tuple[Nuisance, ...]:
    field_unknown = bool(field_sigma[0] >= _UNKNOWN_FIELD_SIGMA_MGAUSS)
    found = [Nuisance.of(WORLD_FIELD, np.zeros(3), field_sigma)]
    # With an unknown field, north is where the field points: a constant yaw error means nothing.
    constant = 0.0 if field_unknown else reference.yaw_sigma_rad
    sigmas = np.array(
        [constant, reference.drift_sigma_radps, reference.bent_sigma_rad, reference.bent_sigma_rad]
    )
    if sigmas.any():
        world = np.mean(rotate(stimulus.rotation[valid], raw[valid]), axis=0)
        field = stimulus.field_ned_mgauss[0]
        offset = math.atan2(field[1], field[0]) - math.atan2(world[1], world[0])
        mean = np.array([float(wrap_pi(offset)) if constant > 0.3 else 0.0, 0.0, 0.0, 0.0])
        found.append(Nuisance.of(REFERENCE_YAW, mean, np.maximum(sigmas, 1e-9)))
    if hold is not None:
        found.append(Nuisance.of(telemetry_age(hold), np.array([0.08]), np.array([0.04])))
    return tuple(found)


def _present(track: Track, stimulus: Stimulus, independent: bool, valid: NDArray[np.bool_]) -> frozenset[str]:
    present = set()
    for name, values in (
        ("current", stimulus.current_a),
        ("throttle", stimulus.throttle),
        ("temperature", stimulus.temperature_degc),
    ):
        if np.isfinite(values).any() and float(np.ptp(values[np.isfinite(values)])) > _LEAST_RANGE[name]:
            present.add(name)
    if stimulus.motors.size and float(np.ptp(stimulus.motors, axis=0).max()) > _LEAST_RANGE["throttle"]:
        present.add("motors")
    position = stimulus.position_ned_m
    if independent and np.isfinite(position).all(axis=1).any():
        if float(np.nanmax(np.nanstd(position, axis=0))) > 0.05:
            present.add("position")
    rotation = stimulus.rotation[valid]
    if len(rotation):
        mean_level = np.abs(np.mean(rotation[:, :2, 0], axis=0))
        if float(np.hypot(*mean_level)) < math.cos(_TURNING_RAD):
            present.add("turning")
        spread = np.sqrt(np.var(rotation[:, 2, 0]) + np.var(rotation[:, 2, 1]))
        if spread > math.sin(_TILT_RAD):
            present.add("tilt")
    if independent:
        present.add("reference")
    return frozenset(present)
