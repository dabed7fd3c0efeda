"""Track: the columns of one recording, whatever it came from.

A live stream, a replay, a log of any format and a CSV all end here. Every quantity keeps its own
clock (`Series`); `time_s` counts from the vehicle's boot (or the file's start) on one clock for all.
Magnetometer readings are kept as the autopilot reported them, beside the correction that was in
force at the time; `Track.raw_field` gives the readings with that correction undone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import accumulate

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mavcompass.correction import IDENTITY, USUAL_EXPONENT, FieldCorrection
from mavcompass.errors import BadRecording
from mavcompass.frames import FloatArray
from mavcompass.saturation import may_saturate, saturated

# The field in RAW_IMU is the average of the last 100 ms, repeated until the next: it lags while turning.
ARDUPILOT_LAG_S = 0.09
# SERVOn_FUNCTION of the motors that ArduPilot corrects for one by one; of the voltage it keeps so much of the
# value of 0.1 s before.
_MOTORS_1_TO_4, _KEPT_OF_VOLTAGE = frozenset({33.0, 34.0, 35.0, 36.0}), 0.9


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """Hold one quantity over time: `time_s` (N,) not decreasing, `values` (N,) or (N, k).

    The columns of `values` lie contiguous in memory, so that column arithmetic is fast.
    """

    time_s: FloatArray
    values: FloatArray

    @classmethod
    def of(cls, time_s: ArrayLike, values: ArrayLike) -> Series:
        """Build a series from any array-likes, in any order; raises ValueError where the lengths differ."""
        times = np.asarray(time_s, dtype=np.float64)
        array = np.asarray(values, dtype=np.float64)
        if times.ndim != 1 or array.shape[:1] != times.shape:
            raise ValueError(f"{times.shape} times do not go with values of shape {array.shape}")
        if bool((times[1:] < times[:-1]).any()):
            order = np.argsort(times, kind="stable")
            times, array = times[order], array[order]
        return cls(np.ascontiguousarray(times), np.asfortranarray(array))

    def __len__(self) -> int:
        """Count the samples."""
        return int(self.time_s.size)

    def at(self, time_s: ArrayLike) -> FloatArray:
        """Interpolate linearly at other times; the ends are held; nan where the series is empty.

        For quantities that wrap (angles) interpolate their sine and cosine, or rotations, instead.
        """
        wanted = np.asarray(time_s, dtype=np.float64)
        if wanted is self.time_s:
            return self.values
        shape = wanted.shape + self.values.shape[1:]
        if not len(self):
            return np.full(shape, np.nan)
        if self.values.ndim == 1:
            return np.interp(wanted, self.time_s, self.values)
        columns = [np.interp(wanted, self.time_s, column) for column in self.values.T]
        return np.asarray(columns).T if columns else np.empty(shape)

    def nearest(self, time_s: ArrayLike, within_s: float) -> FloatArray:
        """Return the value nearest in time, nan where none is as near as `within_s`."""
        wanted = np.asarray(time_s, dtype=np.float64)
        if not len(self):
            return np.full(wanted.shape + self.values.shape[1:], np.nan)
        place = self.nearest_rows(wanted)
        near = np.abs(self.time_s[place] - wanted) < within_s
        found = np.array(self.values[place], dtype=np.float64)
        found[~near] = np.nan
        return found

    def nearest_rows(self, time_s: FloatArray) -> NDArray[np.intp]:
        """Return which reading is nearest in time, of one or more readings."""
        return np.searchsorted(0.5 * (self.time_s[1:] + self.time_s[:-1]), time_s)

    def between(self, start_s: float, end_s: float) -> Series:
        """Cut out start_s <= time < end_s."""
        first, last = np.searchsorted(self.time_s, [start_s, end_s])
        return Series(self.time_s[first:last], self.values[first:last])


@dataclass(frozen=True, slots=True)
class InForce:
    """Say that `correction` was in force from `from_s` on."""

    from_s: float
    correction: FieldCorrection


@dataclass(frozen=True, slots=True, eq=False)
class MagSeries:
    """Hold what one compass reported, and what the autopilot had done to it.

    Attributes:
        instance: counts from 1, as the autopilot counts its compasses.
        reported: the field in body FRD axes, milligauss, (N, 3), as sent or logged.
        in_force: the corrections inside `reported`, oldest first; the first also holds before its time.
        correction_known: False where the recording does not tell its parameters (then identity).
        quantum_mgauss: the step of the numbers, 0 for floats.
        truncated: True where the step was made by truncation toward zero (MAVLink's int16 of ArduPilot).
        device_id: the autopilot's id of the sensor, None where unknown.
        not_applied: the correction that the autopilot has in force but keeps out of `reported` (PX4's
            SCALED_IMU); None where what it has in force is inside.
        less_learnt: True where `reported` is less a bias that an estimator learns in flight and does not tell
            (PX4's HIGHRES_IMU): iron that no correction in force cures is hidden by it.
    """

    instance: int
    reported: Series
    in_force: tuple[InForce, ...] = (InForce(-np.inf, IDENTITY),)
    correction_known: bool = True
    quantum_mgauss: float = 0.0
    truncated: bool = False
    device_id: int | None = None
    not_applied: FieldCorrection | None = None
    less_learnt: bool = False

    @property
    def time_s(self) -> FloatArray:
        """Return the times of the readings, (N,)."""
        return self.reported.time_s

    @property
    def calibration(self) -> FieldCorrection | None:
        """Return the autopilot's last calibration, inside `reported` or not; None where it is not told."""
        if self.not_applied is not None:
            return self.not_applied
        return self.in_force[-1].correction if self.correction_known else None

    def correction_at(self, time_s: float) -> FieldCorrection:
        """Return the correction in force at a time."""
        begun = [step.correction for step in self.in_force if step.from_s <= time_s]
        return begun[-1] if begun else self.in_force[0].correction


def uncut(values: FloatArray, step: float) -> FloatArray:
    """Put numbers that were cut toward zero into the middle of their steps, so that averages are right."""
    return np.asarray(values + 0.5 * step * np.sign(values))


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """Hold one recording as columns. A quantity that was not recorded is None.

    Attributes:
        source: the file's or link's name, for messages.
        autopilot: "ardupilot", "px4" or "unknown"; vehicle: "rover", "copter", ... or "unknown".
        compasses: what each compass reported, by instance (from 1).
        acc_mps2, gyro_radps: specific force and angular rate, body FRD, (N, 3).
        acc_truncation_mps2, gyro_truncation_radps: the step of these numbers where they were cut toward
            zero to whole ones (MAVLink's int16), 0 for floats.
        attitude_rad: the autopilot's own roll, pitch, yaw, (N, 3). Its yaw comes from a compass.
        reference_q: an independent attitude reference (optical, turntable), NED <- FRD, (N, 4).
        truth_q: a simulator's true attitude: for judging results, never an input of a method.
        gps_yaw_rad, gps_velocity_mps (north, east, down), position_ned_m: (N,), (N, 3), (N, 3).
        receiver_velocity_mps: as the receiver itself measured it, where gps_velocity_mps is the autopilot's
            estimate, which a bent compass bends; (N, 3), down may be nan.
        place: latitude deg, longitude deg, altitude m, (N, 3).
        current_a, voltage_v, throttle (0..1), temperature_degc: (N,); motors: outputs 0..1, (N, k).
        utc_offset_s: Unix time of time_s = 0; None where unknown.
        parameters: the vehicle's parameters as last seen in the recording.
        texts: what the autopilot said, each once, the earliest first: its firmware, failsafes, a crash.
        notes: what the reader skipped or supposed, in sentences.
    """

    source: str = ""
    autopilot: str = "unknown"
    vehicle: str = "unknown"
    compasses: Mapping[int, MagSeries] = field(default_factory=dict)
    acc_mps2: Series | None = None
    gyro_radps: Series | None = None
    acc_truncation_mps2: float = 0.0
    gyro_truncation_radps: float = 0.0
    attitude_rad: Series | None = None
    reference_q: Series | None = None
    truth_q: Series | None = None
    gps_yaw_rad: Series | None = None
    gps_velocity_mps: Series | None = None
    receiver_velocity_mps: Series | None = None
    position_ned_m: Series | None = None
    place: Series | None = None
    current_a: Series | None = None
    voltage_v: Series | None = None
    throttle: Series | None = None
    temperature_degc: Series | None = None
    motors: Series | None = None
    utc_offset_s: float | None = None
    parameters: Mapping[str, float] = field(default_factory=dict)
    texts: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def motor_load(
        self, time_s: FloatArray, source: str, exponent: float = USUAL_EXPONENT
    ) -> FloatArray | None:
        """Return the load of a motor correction at the times of readings; None where it was not recorded.

        That of outputs, (N, 4), is ArduPilot's: output, of the range of MOT_PWM, times voltage, to a power
        (Compass_PerMotor.cpp, scaled_output). The voltage is low-passed (Compass_PerMotor.h, set_voltage);
        only a copter's code hands it on (ArduCopter, update_batt_compass: 10 Hz).
        """
        if source != "outputs":
            series = {"current": self.current_a, "throttle": self.throttle}.get(source)
            return None if series is None else series.at(time_s)
        functions = {self.parameters.get(f"SERVO{n}_FUNCTION", 0.0) for n in range(1, 9)}
        known = self.vehicle == "copter" and functions >= _MOTORS_1_TO_4
        if not known or self.motors is None or self.voltage_v is None:
            return None
        late, volts = time_s - self.field_lag_s, _low_passed(self.voltage_v)
        product = self.motors.at(late)[:, :4] * volts.at(late)[:, np.newaxis]
        return np.where(product > 0.0, np.maximum(product, 0.0) ** exponent, 0.0)

    def load_of(self, correction: FieldCorrection, time_s: FloatArray) -> FloatArray | None:
        """Return the load that a correction goes with, at the times of readings; None where not recorded."""
        return self.motor_load(time_s, correction.motor_source, correction.motor_exponent)

    def compass(self, instance: int) -> MagSeries:
        """Return a compass's readings. Raises BadRecording where there are none."""
        compass = self.compasses.get(instance)
        if compass is not None and len(compass.reported):
            return compass
        known = ", ".join(str(i) for i in sorted(self.compasses)) or "none"
        raise BadRecording(
            f"{self.source or 'The recording'} has no readings of compass {instance} (it has: {known}).",
            "Choose one of its compasses with --compass.",
        )

    def raw_field(self, instance: int = 1, motors: bool = True) -> FloatArray:
        """Undo the corrections in force: the readings (N, 3) of one compass in body axes, milligauss.

        `motors` False leaves the motor compensation in: what is kept in force has to stay in the data.
        Raises KeyError for a compass that the recording does not have.
        """
        compass = self.compasses[instance]
        raw = np.empty_like(compass.reported.values)
        starts = np.array([step.from_s for step in compass.in_force])
        starts[0] = -np.inf
        edges = [*np.searchsorted(compass.time_s, starts), len(compass.reported)]
        for step, first, last in zip(compass.in_force, edges[:-1], edges[1:], strict=True):
            rows = slice(int(first), int(last))
            load = self.load_of(step.correction, compass.time_s[rows]) if motors else None
            raw[rows] = step.correction.undo(compass.reported.values[rows], load)
        return raw

    def saturated(self, instance: int = 1) -> NDArray[np.bool_]:
        """Mark the readings of one compass at the end of what its sensor can show, (N,)."""
        return saturated(self.raw_field(instance, motors=False), self.compasses[instance].quantum_mgauss)

    def may_saturate(self, instance: int = 1) -> bool:
        """Tell whether the largest readings of one compass pile up as at a sensor's limit."""
        return may_saturate(self.raw_field(instance), self.compasses[instance].quantum_mgauss)

    def corrected_field(self, instance: int = 1) -> FloatArray:
        """Return the readings (N, 3) of one compass by the autopilot's calibration, body axes, milligauss.

        Raises KeyError for a compass that the recording does not have.
        """
        compass = self.compasses[instance]
        own = compass.not_applied
        if own is None:
            return np.asarray(compass.reported.values)
        return own.apply(compass.reported.values, self.load_of(own, compass.time_s))

    def centred(self, instance: int) -> Track:
        """Put readings that were cut toward zero into the middle of their steps, so that averages are right.

        Raises KeyError for a compass that the recording does not have.
        """
        compass = self.compasses[instance]
        if not compass.truncated:
            return self
        middle = Series.of(compass.time_s, uncut(compass.reported.values, compass.quantum_mgauss))
        whole = replace(compass, reported=middle, truncated=False)
        return replace(self, compasses={**self.compasses, instance: whole})

    @property
    def field_lag_s(self) -> float:
        """Return how far the recorded field is known to lag behind the gyro."""
        return ARDUPILOT_LAG_S if self.autopilot == "ardupilot" else 0.0

    def columns(self) -> Iterator[tuple[str, Series]]:
        """Yield what was recorded by its name; a compass's readings go by `compass 1`."""
        for name in self.__slots__:
            if isinstance(series := getattr(self, name), Series):
                yield name, series
        for instance, compass in self.compasses.items():
            yield f"compass {instance}", compass.reported

    def with_columns(self, change: Callable[[str, Series], Series | None]) -> Track:
        """Change every one of `columns`; what becomes None is gone."""
        changed = {name: change(name, series) for name, series in self.columns()}
        compasses = {
            i: replace(compass, reported=reported)
            for i, compass in self.compasses.items()
            if (reported := changed.pop(f"compass {i}")) is not None
        }
        return replace(self, compasses=compasses, **changed)  # type: ignore[arg-type]

    def with_times(self, moved: Callable[[FloatArray], FloatArray]) -> Track:
        """Let everything have happened at other times, in the same order."""
        track = self.with_columns(lambda _, series: Series(moved(series.time_s), series.values))
        compasses = {
            i: replace(
                compass,
                in_force=tuple(
                    replace(step, from_s=float(moved(np.array(step.from_s))))
                    if np.isfinite(step.from_s)
                    else step
                    for step in compass.in_force
                ),
            )
            for i, compass in track.compasses.items()
        }
        return replace(track, compasses=compasses)

    def between(self, start_s: float, end_s: float) -> Track:
        """Cut out start_s <= time < end_s of every column."""
        return self.with_columns(lambda _, series: series.between(start_s, end_s))

    def shifted(self, by_s: float) -> Track:
        """Let everything have happened later by some seconds."""
        return self.with_times(lambda time_s: time_s + by_s)

    @property
    def duration_s(self) -> float:
        """Return the time from the first to the last magnetometer reading of any compass."""
        ends = [(c.time_s[0], c.time_s[-1]) for c in self.compasses.values() if len(c.reported)]
        return float(max(e[1] for e in ends) - min(e[0] for e in ends)) if ends else 0.0


def _low_passed(series: Series) -> Series:
    """Smooth a voltage as ArduPilot does."""
    kept = _KEPT_OF_VOLTAGE ** (np.diff(series.time_s, prepend=series.time_s[:1]) / 0.1)
    steps = zip(kept.tolist(), series.values.tolist(), strict=True)
    smooth = accumulate(steps, lambda was, now: (0.0, now[0] * was[1] + (1.0 - now[0]) * now[1]))
    return Series(series.time_s, np.array([value for _, value in smooth]))


def joined(tracks: Sequence[Track]) -> Track:
    """Join pieces of one recording, in order of time; what is not a column is taken from the last."""
    last = tracks[-1]
    pieces: dict[str, list[Series]] = {}
    for track in tracks:
        for name, series in track.columns():
            pieces.setdefault(name, []).append(series)
    # A message that came late lies in the piece after its own: a series puts it in order.
    whole = {
        name: Series.of(np.concatenate([s.time_s for s in some]), np.concatenate([s.values for s in some]))
        for name, some in pieces.items()
    }
    compasses = {i: replace(one, reported=whole[f"compass {i}"]) for i, one in last.compasses.items()}
    columns = {name: series for name, series in whole.items() if name in last.__slots__}
    return replace(last, compasses=compasses, **columns)  # type: ignore[arg-type]
