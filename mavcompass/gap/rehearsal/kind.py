"""A kind of vehicle: all that a recording and its diagnosis tell of one, as distributions to draw from.

The diagnosis may be one that was stored (`gap diagnose --json`).
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mavcompass.calibration.observation import Dwell, dwell_between, turn_record
from mavcompass.calibration.observation.turning import TurnRecord
from mavcompass.earth_field import EarthField, earth_field_of
from mavcompass.errors import BadRecording, PoorCalibration, UsageError
from mavcompass.files import read_text, sha256_of
from mavcompass.frames import FloatArray
from mavcompass.gap.attitude.reference import Choice
from mavcompass.gap.replay.nominal import Replay, replay
from mavcompass.gap.replay.nuisance import KnownIron
from mavcompass.gap.result import SCHEMA as DIAGNOSIS_SCHEMA
from mavcompass.gap.result import Cause, Diagnosis, PosteriorComponent, Verdict
from mavcompass.gap.tables import usual
from mavcompass.simulation.effects import get
from mavcompass.simulation.physics.signals import Stimulus
from mavcompass.track import Track


@dataclass(frozen=True, slots=True)
class Stored:
    """Hold what a rehearsal takes from a diagnosis, and the recording that it is of."""

    recording: Path
    compass: int
    verdict: Verdict
    causes: tuple[Cause, ...]
    beliefs: tuple[PosteriorComponent, ...]


def read_stored(path: Path) -> Stored:
    """Read a diagnosis and find its recording, where it was or beside the file.

    Raises UsageError where the file is no diagnosis, or its recording is gone or another.
    """
    try:
        document = json.loads(read_text(path))
        if document["schema"] != DIAGNOSIS_SCHEMA:
            raise ValueError(document["schema"])
        log = document["log"]
        stored = Stored(
            recording=_recording(path, log["path"], log["sha256"]),
            compass=document["compass"],
            verdict=document["verdict"],
            causes=tuple(map(_cause, document["causes"])),
            beliefs=tuple(map(PosteriorComponent.from_json, document["beliefs"])),
        )
    except (OSError, ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        raise UsageError(
            f"{path} is no diagnosis that can be rehearsed.",
            "Name the recording itself, or what `mavcompass gap diagnose LOG --json FILE` writes for one"
            " recording; what earlier versions wrote does not hold enough.",
        ) from error
    return stored


def _recording(path: Path, named: str, sha256: str) -> Path:
    places = (Path(named), path.parent / Path(named).name)
    found = next((place for place in places if place.is_file()), None)
    if found is None:
        raise UsageError(
            f"{path} is the diagnosis of {named}, which is not there.",
            "A rehearsal also needs the recording, for how the vehicle stands: put it beside the diagnosis.",
        )
    if sha256_of(found) != sha256:
        raise UsageError(
            f"{found} is not the recording that {path} is the diagnosis of.", "Diagnose it anew."
        )
    return found


def _cause(document: dict[str, Any]) -> Cause:
    return Cause(
        effect=document["effect"],
        parameters={name: float(value) for name, value in document["parameters"].items()},
        ci95={name: (float(low), float(high)) for name, (low, high) in document["ci95"].items()},
        probability=float(document["probability"]),
        ambiguous_with=tuple(document["ambiguous_with"]),
    )


def stances_of(
    track: Track, instance: int, record: TurnRecord, horizontal_mgauss: float, vertical_mgauss: float
) -> tuple[Dwell, ...]:
    """Find up to 24 stretches in which the vehicle stood or hovered, such as follow a turn before all others.

    Raises BadRecording where there is none.
    """
    times = track.compasses[instance].time_s
    rate_hz = (times.size - 1) / max(float(times[-1] - times[0]), 1e-3)
    slow = max(usual.stance.readings_hz / rate_hz, 1.0)
    found = []
    for middle in _calm(track, record, usual.stance.long_s * slow, times):
        stance = _dwell(track, instance, record, middle, usual.stance.short_s * slow)
        if (
            stance is None
            or stance.heading_sigma_rad(horizontal_mgauss, vertical_mgauss) > usual.stance.enough_rad
        ):
            stance = _dwell(track, instance, record, middle, usual.stance.long_s * slow)
        if stance is not None:
            found.append(stance)
    if not found:
        raise BadRecording(
            "There is no stretch in which compass and gyro were recorded together.",
            "Record the vehicle standing or hovering for some seconds.",
        )
    return tuple(found)


def _dwell(track: Track, instance: int, record: TurnRecord, middle: float, length_s: float) -> Dwell | None:
    try:
        return dwell_between(track, instance, middle - 0.5 * length_s, middle + 0.5 * length_s, record)
    except PoorCalibration:
        return None


def _calm(track: Track, record: TurnRecord, length_s: float, times: FloatArray) -> list[float]:
    """Return the middles of calm stretches that do not overlap: after turns, the calmest, then others.

    What flies is looked at while it flies: on the ground it stands as it never will in the air.
    """
    middles = np.arange(times[0] + 0.5 * length_s, times[-1] - 0.5 * length_s, 0.25 * length_s)
    rates = np.hypot(record.rate_radps, record.tilt_rate_radps)
    moved = np.concatenate([[0.0], np.cumsum(0.5 * (rates[1:] + rates[:-1]) * np.diff(record.time_s))])
    around = [middles - 0.5 * length_s, middles + 0.5 * length_s]
    unrest = np.diff(np.interp(around, record.time_s, moved), axis=0)[0] / length_s
    if track.vehicle == "copter" and track.throttle is not None and len(track.throttle):
        flying = np.nan_to_num(track.throttle.at(middles)) > usual.stance.motors_on
        if flying.any():
            middles, unrest = middles[flying], unrest[flying]
    turning = np.append(-np.inf, record.time_s[np.abs(record.rate_radps) > usual.stance.turning_radps])
    starts = middles - 0.5 * length_s
    since_s = starts - turning[np.searchsorted(turning, starts) - 1]
    settling = (since_s < usual.stance.afterwards_s) & (unrest <= usual.stance.calm_radps)
    chosen: list[float] = []
    for i in np.lexsort((unrest, ~settling)):
        if len(chosen) == usual.stance.most or (len(chosen) >= usual.stance.fewest and not settling[i]):
            break
        if all(abs(middles[i] - other) >= length_s for other in chosen):
            chosen.append(float(middles[i]))
    return chosen


@dataclass(frozen=True, slots=True, eq=False)
class Kind:
    """Hold a vehicle as its recording shows it.

    Attributes:
        beliefs: what may be wrong with it, and with the place. faults: causes that are told apart from these
            (accelerometer, gyro).
        iron: what the correction in force cures.
        field_ned_mgauss: the field (3,) to which a belief adds. earth: the field as a calibration has it;
            None where the place is unknown.
        stances: how it stands. still: the loads and places that go with them; used: those of all readings.
        turns: how surely the angle between two stances is known.
    """

    beliefs: tuple[PosteriorComponent, ...]
    faults: tuple[Cause, ...]
    iron: KnownIron
    field_ned_mgauss: FloatArray
    earth: EarthField | None
    stances: tuple[Dwell, ...]
    still: Stimulus
    used: Stimulus
    turns: TurnRecord
    vehicle: str

    @property
    def effects(self) -> tuple[str, ...]:
        """Return the ids of all effects that it may have, the likeliest explanation's first."""
        ids = [effect for belief in self.beliefs for effect in belief.effects]
        return tuple(dict.fromkeys([*ids, *(fault.effect for fault in self.faults)]))


def kind_of(track: Track, diagnosis: Diagnosis | Stored, reference: Choice = "auto") -> Kind:
    """Collect what a recording and its diagnosis tell of a vehicle.

    Raises BadRecording without a gyro, or where compass and gyro are never recorded together.
    """
    replayed, earth = replay(track, diagnosis.compass, reference), earth_field_of(track)
    record = turn_record(track, diagnosis.compass)
    if record is None:
        raise BadRecording(
            "The recording has no gyro: how surely this vehicle's turns are known cannot be told.",
            "Record the angular rate too (RAW_IMU, SCALED_IMU or IMU messages).",
        )
    stimulus = replayed.signals.stimulus
    field = np.asarray(stimulus.field_ned_mgauss[0])
    level = float(np.hypot(field[0], field[1]))
    stances = stances_of(track, diagnosis.compass, record, level, float(field[2]))
    named = {effect for belief in diagnosis.beliefs for effect in belief.effects}
    told = [_with_field_held(belief, replayed, earth) for belief in diagnosis.beliefs]
    middles = np.array([0.5 * (stance.start_s + stance.end_s) for stance in stances])
    nearest = np.clip(np.searchsorted(stimulus.time_s, middles), 0, stimulus.time_s.size - 1)
    return Kind(
        beliefs=tuple(told),
        faults=tuple(c for c in diagnosis.causes if c.effect not in named and get(c.effect).kind == "mean"),
        iron=replayed.iron,
        field_ned_mgauss=field,
        earth=earth,
        stances=stances,
        still=rows_of(stimulus, nearest),
        used=rows_of(stimulus, np.flatnonzero(replayed.valid)),
        turns=record,
        vehicle=track.vehicle,
    )


def rows_of(stimulus: Stimulus, rows: np.ndarray) -> Stimulus:
    """Take rows of a stimulus."""
    return Stimulus(*(getattr(stimulus, name)[rows] for name in Stimulus.__slots__))


def _with_field_held(
    belief: PosteriorComponent, replayed: Replay, earth: EarthField | None
) -> PosteriorComponent:
    """Hold the field to what the world model leaves open where the recording told nothing of it.

    Where a vehicle does not turn, or its place is unknown, the field and the vehicle's offset cannot be told
    apart.
    """
    sigma = usual.place.anomaly * float(np.linalg.norm(replayed.signals.stimulus.field_ned_mgauss[0]))
    if math.sqrt(float(np.diag(belief.covariance)[:3].max())) < usual.place.told * sigma:
        return belief
    gain = belief.covariance[:, :3] @ np.linalg.inv(belief.covariance[:3, :3] + sigma**2 * np.eye(3))
    off = -belief.mean[:3] if earth is not None else np.zeros(3)
    covariance = belief.covariance - gain @ belief.covariance[:3, :]
    return replace(belief, mean=belief.mean + gain @ off, covariance=covariance)
