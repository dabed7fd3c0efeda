"""Replay a recording through the simulation: its own inputs in, the nominal readings out.

The calibration in force is undone first; the field is the world model's; what a healthy autopilot does
to a reading (ten readings a second, averaged, repeated, late) belongs to the replay, not to the gap.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from mavcompass.correction import IDENTITY
from mavcompass.errors import BadRecording
from mavcompass.frames import FloatArray, rotate, rotate_back, wrap_pi
from mavcompass.gap.attitude.kinematics import averaged
from mavcompass.gap.attitude.reference import Choice, Reference, reference_attitude
from mavcompass.gap.replay.integrity import Readings, Trace
from mavcompass.gap.replay.noise import SensorNoise
from mavcompass.gap.replay.nuisance import (
    WORLD_FIELD,
    KnownIron,
    Prior,
    known_iron,
    load_of,
    of_telemetry,
    reference_attitude_error,
)
from mavcompass.gap.replay.rows import compass_rows, middles, shared_period_s, swing, unbroken
from mavcompass.gap.replay.surroundings import (
    column,
    compass_of,
    every_s,
    goes_about,
    place_of,
    position_of,
    present_in,
    scalar,
    world_field,
)
from mavcompass.gap.tables import usual
from mavcompass.simulation.effects.causes.timing import LONGEST_LAG_S
from mavcompass.simulation.effects.effect import Effect, Group, Signals, Stage
from mavcompass.simulation.effects.sampling import thinned
from mavcompass.simulation.physics.signals import Reading, RecordedStimulus, Stimulus, Turning, ideal
from mavcompass.track import Series, Track
from mavcompass.units import STANDARD_GRAVITY_MPS2

# Motors that turn both ways stand still at half of their output.
_NEUTRAL_IN_THE_MIDDLE = frozenset({"rover", "ackermann-rover", "boat", "sub"})
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
        corrected_mgauss: the compass with the calibration in force, (N, 3); None where none is known.
        valid: rows with a reading and a reference, from as late on as a reading may be late, (N,).
        groups: the sensors that can be compared: the compass always, accelerometer and gyro where the
            reference did not come from them.
        prior: what must be solved for besides any effect, and what is known of it beforehand.
        present: what the recording contains of the needs of effects.
        reference: where the attitude comes from.
        resolution_mgauss: the noise that the numbers' steps alone make.
        telemetry: True where readings are repeated and late by the autopilot's nature.
        field_known: True where the world model gave the field.
        trace: repeats and steps of the numbers, as they were logged.
        iron: what the calibration in force says of the raw sensor.
        nominal_mgauss: what the raw sensor says if that is right and nothing else is wrong, (N, 3).
        readings: every reading, of which the rows are means; averaged: of how many neighbours each;
            late_s: by how much the rows are earlier than their readings came.
        place: latitude, longitude in degrees, altitude in metres; None where unknown.
        doubtful: sensors that the simulation does not explain in detail where nothing is wrong, with the
            noise that makes up for it: they speak for causes, but what they leave is no unknown cause.
        loads_every_s: how often the loads were recorded.
        notes: what a reader of the result must know.
    """

    signals: Signals
    measured: Reading
    valid: NDArray[np.bool_]
    groups: tuple[Group, ...]
    prior: Prior
    present: frozenset[str]
    reference: Reference
    resolution_mgauss: float
    telemetry: bool
    field_known: bool
    trace: Trace
    notes: tuple[str, ...]
    iron: KnownIron
    nominal_mgauss: FloatArray
    readings: Readings
    corrected_mgauss: FloatArray | None = None
    averaged: int = 1
    late_s: float = 0.0
    place: tuple[float, float, float] | None = None
    doubtful: Mapping[Group, SensorNoise] = field(default_factory=dict)
    loads_every_s: float = 0.0

    @property
    def time_s(self) -> FloatArray:
        """Return the times of the rows, (N,)."""
        return self.signals.stimulus.time_s

    def without(self, change_mgauss: FloatArray) -> Replay:
        """Take what an effect adds to every raw reading (M, 3) out of readings and rows."""
        picked = middles(len(change_mgauss), self.averaged)
        change = averaged(change_mgauss, self.averaged)[picked]
        corrected = self.corrected_mgauss
        if corrected is not None:
            corrected = corrected - change @ np.linalg.inv(self.iron.matrix).T
        return replace(
            self,
            measured=replace(self.measured, mag_mgauss=self.measured.mag_mgauss - change),
            corrected_mgauss=corrected,
            readings=self.readings.without(change_mgauss),
        )


def broken(source: str) -> BadRecording:
    """Say that nothing is left of a recording beside its breaks."""
    return BadRecording(
        f"{source or 'The recording'} has breaks between readings all the time.",
        "Record compass and attitude together, at an even rate.",
    )


def replay(
    track: Track,
    instance: int = 1,
    choice: Choice = "auto",
    period_s: float | None = None,
    most_averaged: int | None = None,
    alone: bool = False,
    late_s: float | None = None,
) -> Replay:
    """Build the nominal simulation of one compass of a recording, averaged to rows of a period.

    Beside a recording with fewer readings, a baseline's rows are means of no more than its. Where no baseline
    tells how good the attitude is (`alone`), a yaw without a witness may wander. Means are put to when they
    were taken: by how late the readings are themselves, or by `late_s`, where a baseline tells.

    Raises BadRecording where there is no such compass, or too little to compare.
    """
    compass = compass_of(track, instance)
    period_s = shared_period_s([track], instance) if period_s is None else period_s
    rows = compass_rows(track, compass, period_s, most_averaged)
    picked = middles(rows.time_s.size, rows.width)
    whole = reference_attitude(track, rows.time_s, choice, instance, picked)
    told_mgauss = rows.raw_mgauss if rows.corrected_mgauss is None else rows.corrected_mgauss
    field, sigma, field_notes = world_field(track, instance, rows.time_s, whole, told_mgauss)
    correction = compass.calibration or IDENTITY
    known = whole.known & rows.usable
    raw, corrected, usable, told_s = rows.raw_mgauss, rows.corrected_mgauss, rows.usable, 0.0
    swings = np.zeros_like(raw)
    if rows.width > 1:
        upright = rotate_back(whole.rotation, np.broadcast_to(field, raw.shape))
        slopes = np.cross(upright, whole.rate_radps)
        swings, told_s = swing(rows.time_s, raw, upright, slopes, known, rows.width)
        # What moves or is switched does so when readings are taken: means are put there, if these come often
        # enough to tell it.
        often = float(np.median(np.diff(rows.time_s))) <= usual.gyro.slowest_s
        told_s = (told_s if late_s is None else late_s) if rows.telemetry and often else 0.0
    told, taken_s = whole, rows.time_s - told_s
    whole = told.earlier(rows.time_s, told_s)
    time_s, reference = taken_s[picked], whole.thinned()
    if alone:
        reference = reference.alone(time_s)
    position = position_of(track, reference)
    turns = thinned(Turning(rows.time_s, told.rotation, told.rate_radps, reference.rotation))
    stimulus = _stimulus(track, position, taken_s, rows.width, reference, field, turns)
    iron = known_iron(correction, *load_of(correction.motor_source, stimulus.current_a, stimulus.throttle))
    seen = rotate_back(whole.rotation, np.broadcast_to(field, raw.shape))
    readings = Readings.of(rows.time_s, raw, iron.raw(seen, np.interp(taken_s, time_s, iron.load)), known)
    if rows.width > 1:
        raw = averaged(raw, rows.width)[picked] + swings[picked]
        if corrected is not None:
            swings = swings[picked] @ np.linalg.inv(iron.matrix).T
            corrected = averaged(corrected, rows.width)[picked] + swings
        usable = np.asarray(np.isfinite(raw).all(axis=1) & unbroken(rows.time_s, rows.width))
    nominal = ideal(stimulus)
    # A mean with what turning adds to the middle is a reading of it.
    acc, gyro = (
        column(series, time_s, rows.width, rows.time_s) + (every - averaged(every, rows.width))[picked]
        for series, every in ((track.acc_mps2, _at_rest(whole)), (track.gyro_radps, whole.rate_radps))
    )
    independent = reference.kind == "columns"
    about = goes_about(position, reference)
    present = present_in(stimulus, reference, about, reference.known & usable)
    if track.may_saturate(instance):
        present |= {"limit"}
    if not present & {"turning", "tilt"}:
        # A constant offset in body axes is then a constant field: its size can be anything.
        sigma = np.maximum(sigma, usual.place.unknown_mgauss)
        field_notes = (*field_notes, _NO_TURN)
    groups: tuple[Group, ...] = ("mag",)
    # What was before the recording is not known, and what is late or smoothed says it at first.
    valid = reference.known & usable & (time_s - time_s[0] >= LONGEST_LAG_S)
    if not valid.any():
        raise broken(track.source)
    inertial: tuple[tuple[Group, FloatArray], ...] = (("acc", acc), ("gyro", gyro))
    motion_note: tuple[str, ...] = ()
    for name, values in inertial:
        if independent and np.isfinite(values[valid]).all() and np.abs(values).sum() > 0.0:
            off = np.median(
                np.abs(values - (nominal.acc_mps2 if name == "acc" else nominal.gyro_radps))[valid]
            )
            if name == "acc" and off > usual.present.unfelt_mps2:
                motion_note = ("The accelerometer feels motion that the recording does not tell: left out.",)
                continue
            groups = (*groups, name)
    read_every_s = float(np.median(np.diff(readings.time_s))) if rows.telemetry else 0.0
    return Replay(
        signals=Signals(stimulus, nominal),
        measured=Reading(raw, acc, gyro),
        valid=valid,
        groups=groups,
        prior=_prior(
            reference, stimulus, raw if corrected is None else corrected, sigma, read_every_s, valid, told_s
        ),
        present=present,
        reference=reference,
        resolution_mgauss=track.compasses[instance].quantum_mgauss / math.sqrt(12.0),
        telemetry=rows.telemetry,
        trace=rows.trace,
        field_known=sigma[0] < usual.place.unknown_mgauss,
        notes=(*track.notes, *reference.notes, *field_notes, *motion_note),
        corrected_mgauss=corrected,
        iron=iron,
        nominal_mgauss=iron.raw(nominal.mag_mgauss),
        readings=readings,
        averaged=rows.width,
        late_s=told_s,
        place=place_of(track),
        loads_every_s=every_s(track.current_a, track.throttle),
    )


def _at_rest(reference: Reference) -> FloatArray:
    """Return the specific force of what does not accelerate, (N, 3)."""
    return reference.rotation[:, 2, :] * -STANDARD_GRAVITY_MPS2


def level_mgauss(replay: Replay) -> float:
    """Return the level part of the field where a recording begins, mG, at least 1."""
    north, east, _ = replay.signals.stimulus.field_ned_mgauss[0]
    return max(float(np.hypot(north, east)), 1.0)


def _stimulus(
    track: Track,
    position: Series | None,
    taken_s: FloatArray,
    width: int,
    reference: Reference,
    field: FloatArray,
    turning: Turning,
) -> Stimulus:
    picked = middles(taken_s.size, width)
    time_s = taken_s[picked]
    n = time_s.size
    motors = np.empty((n, 0))
    if track.motors is not None and len(track.motors) > 1:
        motors = averaged(np.nan_to_num(track.motors.at(taken_s)), width)[picked]
        if track.vehicle in _NEUTRAL_IN_THE_MIDDLE:
            motors = 2.0 * motors - 1.0
    return RecordedStimulus(
        time_s=time_s,
        rotation=reference.rotation,
        field_ned_mgauss=np.tile(field, (n, 1)),
        rate_radps=reference.rate_radps,
        specific_force_mps2=_at_rest(reference),
        position_ned_m=column(position, time_s),
        velocity_ned_mps=column(track.gps_velocity_mps, time_s),
        # What a load adds is averaged as the readings are.
        current_a=averaged(scalar(track.current_a, taken_s)[:, None], width)[picked, 0],
        throttle=averaged(scalar(track.throttle, taken_s)[:, None], width)[picked, 0],
        temperature_degc=scalar(track.temperature_degc, time_s),
        motors=motors,
        turning=turning,
    )


def _prior(
    reference: Reference,
    stimulus: Stimulus,
    calibrated: FloatArray,
    field_sigma: FloatArray,
    read_every_s: float,
    valid: NDArray[np.bool_],
    late_s: float,
) -> Prior:
    """Say what is usual; an autopilot reads its compass `read_every_s`, 0 where none reports it."""
    field_unknown = bool(field_sigma[0] >= usual.place.unknown_mgauss)
    found = [Prior.of(WORLD_FIELD, np.zeros(3), field_sigma)]
    # With an unknown field, north is where the field points: a constant yaw error means nothing.
    constant = 0.0 if field_unknown else reference.yaw_sigma_rad
    if constant > 0.0 or reference.curves_rad.size:
        world = np.mean(rotate(stimulus.rotation[valid], calibrated[valid]), axis=0)
        field = stimulus.field_ned_mgauss[0]
        offset = math.atan2(field[1], field[0]) - math.atan2(world[1], world[0])
        mean, sigma = np.zeros((2, 1 + reference.curves_rad.shape[2]))
        mean[0] = float(wrap_pi(offset)) if constant > usual.yaw.unknown_rad else 0.0
        sigma[:], sigma[0] = 1.0, max(constant, 1e-9)
        effect = reference_attitude_error(reference.curves_rad, reference.with_yaw)
        found.append(Prior.of(effect, mean, sigma))
    if read_every_s > 0.0:
        found += of_telemetry(late_s, read_every_s)
    return Prior().beside(*found)


_NO_SENSOR = (
    "the sensors that would show it were not recorded, or feel motion that the recording does not tell"
)
_NEED_WORDS = {
    "turning": "the vehicle does not turn far enough",
    "tilt": "the vehicle stays level",
    "current": "no varying battery current was recorded",
    "throttle": "no varying throttle was recorded",
    "motors": "no varying motor outputs were recorded",
    "temperature": "no varying temperature was recorded",
    "position": "no precise position was recorded, or the vehicle did not move",
    "height": "no height was recorded, or the vehicle kept it",
    "limit": "the largest readings do not pile up, as they do at a sensor's limit",
    "reference": "the attitude reference was made from the vehicle's own sensors",
    "throttle|current|motors": "neither throttle nor current nor motor outputs were recorded",
}


def half_testable(replayed: Replay, effects: Iterable[Effect]) -> frozenset[str]:
    """List the effects that only lack motion: what there is shows a part of them, never enough to be sure.

    They compete in the search, lest another be blamed for that part; a winner among them is called ambiguous.
    """
    within = replayed.present | {"tilt", "turning"}
    return frozenset(
        e.id
        for e in effects
        if e.lacking(replayed.present)
        and not e.lacking(within)
        and all(g in replayed.groups for g in e.groups)
    )


def untestable_effects(
    replayed: Replay, effects: Iterable[Effect], age_known: bool = False
) -> dict[str, str]:
    """Say for each effect that this recording cannot test why not.

    `age_known` tells that a baseline has taught how late the autopilot's readings are by nature.
    """
    out: dict[str, str] = {}
    for effect in effects:
        for need in effect.lacking(replayed.present):
            out[effect.id] = _NEED_WORDS[need]
        seen = all(g in replayed.groups for g in effect.groups) or any(
            g in replayed.groups for g in effect.enough
        )
        if not seen and effect.id not in out:
            away = "reference" not in replayed.present
            out[effect.id] = _NEED_WORDS["reference"] if away else _NO_SENSOR
        if len(effect.groups) == 1 and effect.groups[0] in replayed.doubtful:
            # What is not known of the motion looks like any fault of the sensor that feels it.
            out[effect.id] = _NO_SENSOR
        # A baseline that was read in the same way teaches how late, and how smooth, readings are by nature.
        repeats, jitter = effect.detector == "repeats", effect.detector == "jitter"
        taught = (age_known and not jitter) or (replayed.trace.froze and repeats)
        if replayed.telemetry and (effect.stage is Stage.TIMING or repeats) and not taught:
            out[effect.id] = "the compass is read more slowly than it is logged, and repeated: late by nature"
        if replayed.averaged > 1 and jitter:
            out[effect.id] = (
                f"{replayed.averaged} neighbours each were averaged, so long is the recording: cut a part out"
            )
        if not replayed.field_known and effect.stage is Stage.WORLD and not effect.needs:
            out[effect.id] = "the recording does not say where it was made"
        if replayed.reference.yaw_unknown and effect.about_vertical:
            out[effect.id] = "the initial yaw is solved with the field: a constant turn is part of it"
        if effect.detector == "drift":
            out[effect.id] = "a wandering offset can imitate any slow cause, so it is reported as unknown"
    return out
