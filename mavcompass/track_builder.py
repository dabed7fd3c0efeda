"""TrackBuilder: turn a live stream of messages into the Track that a recording gives, with a sound clock.

Others work on grids over time, so a span must be one that samples bear out. A time stamp is a number in a
file, and may be any. A quantity whose samples all share one moment, or came faster than any sensor gives
them, has no clock. And a recording lasts no longer than its samples can carry: where it would, its longest
silences are shortened, all to one length, as far as that takes.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from mavcompass import messages as mav
from mavcompass.correction import IDENTITY, FieldCorrection
from mavcompass.credible import open_ended, quaternions_of, turned_field, with_credible_readings
from mavcompass.frames import FloatArray
from mavcompass.messages import telemetry
from mavcompass.messages.bits import number_told
from mavcompass.track import InForce, MagSeries, Series, Track
from mavcompass.units import MPS2_PER_MILLI_G, RADPS_PER_MILLIRADPS

_IMU_MESSAGES: dict[type[mav.Message], str] = {
    mav.RawImu: "RAW_IMU",
    mav.ScaledImu: "SCALED_IMU",
    mav.ScaledImu2: "SCALED_IMU2",
    mav.ScaledImu3: "SCALED_IMU3",
}

_OTHER_CLOCK_S = 30.0
# Five hours at 50 Hz, or 80 MB of a message with ten numbers.
_MOST_ROWS = 1_000_000


@dataclass(slots=True)
class _Rows:
    """Collect the rows of one series; put in order of time when it is built."""

    times: array[float] = field(default_factory=lambda: array("d"))
    values: array[float] = field(default_factory=lambda: array("d"))

    def add(self, time_s: float, *values: float) -> None:
        # Who floods the link does not fill the memory.
        if not any(map(math.isnan, values)) and len(self.times) < _MOST_ROWS:
            self.times.append(time_s)
            self.values.extend(values)

    def series(self) -> Series | None:
        if not self.times:
            return None
        times = np.array(self.times)
        # A radio link may deliver late or twice: sort by the vehicle's clock, keep the first of each.
        times, first = np.unique(times, return_index=True)
        values = np.array(self.values).reshape(len(self.times), -1)[first]
        return Series.of(times, values[:, 0] if values.shape[1] == 1 else values)


class TrackBuilder:
    """Append messages as they are heard; `build` gives the Track so far.

    Times are the vehicle's: seconds since its boot. Messages that carry none are placed by their
    arrival and the smallest delay seen so far between the two clocks. A clock that jumps back (the
    autopilot was restarted) starts the columns anew: parts before and after do not belong together.
    """

    def __init__(self, autopilot: str = "unknown", vehicle: str = "unknown", source: str = "") -> None:
        self.autopilot = autopilot
        self.vehicle = vehicle
        self.source = source
        self.parameters: dict[str, float] = {}
        self.restarts = 0
        self._in_force: dict[int, list[InForce]] = {}
        self._rotations: dict[int, FloatArray] = {}
        self._turned: dict[int, tuple[float, FloatArray]] = {}
        self._not_applied: dict[int, FieldCorrection] = {}
        self._start_anew()

    def _start_anew(self) -> None:
        self._clear()
        self._offset_s: float | None = None
        self._utc_offset_s: float | None = None
        self.latest_s = -np.inf
        # Times of the clock before mean nothing on the new one.
        self._in_force = {i: [InForce(-np.inf, steps[-1].correction)] for i, steps in self._in_force.items()}
        self._turned = {}

    def _clear(self) -> None:
        self._imu = {name: _Rows() for name in telemetry.MAG_MESSAGES}
        self._columns: dict[str, _Rows] = {}

    def set_correction(self, instance: int, correction: FieldCorrection) -> None:
        """Say which correction the autopilot applies to a compass after the latest message."""
        steps = self._in_force.setdefault(instance, [])
        steps.append(InForce(np.nextafter(self.latest_s, np.inf) if steps else -np.inf, correction))

    def turn(self, instance: int, rotation: FloatArray) -> None:
        """Say that a compass is reported by another mounting from the latest message on, turned by (3, 3)."""
        steps = self._in_force.get(instance, [])
        steps[:] = [InForce(step.from_s, step.correction.turned(rotation)) for step in steps]
        self._turned[instance] = (self.latest_s, rotation)

    def set_raw(self, instance: int, sensor_to_body: FloatArray, in_force: FieldCorrection) -> None:
        """Say that a compass is reported raw: how to turn it into body axes, and what is in force."""
        self._rotations[instance] = sensor_to_body
        self._not_applied[instance] = in_force

    def vehicle_time_s(self, link_time_s: float) -> float:
        """Turn a time of the link's clock into the vehicle's; the link's while none is known."""
        return link_time_s - (self._offset_s or 0.0)

    def add(self, heard: mav.Incoming) -> None:
        """Append one message; those without a meaning for a Track are passed over."""
        message = heard.message
        if isinstance(message, mav.RawImu | mav.ScaledImu):
            self._add_imu(heard.time_s, message)
        elif isinstance(message, mav.Attitude):
            time_s = message.time_boot_ms * 1e-3
            self._note_clock(heard.time_s, time_s)
            self._column("attitude_rad").add(time_s, message.roll, message.pitch, message.yaw)
        elif isinstance(message, mav.GlobalPositionInt):
            time_s = message.time_boot_ms * 1e-3
            self._column("place").add(time_s, *telemetry.place(message).tolist())
        elif isinstance(message, mav.LocalPositionNed):
            self._column("position_ned_m").add(message.time_boot_ms * 1e-3, message.x, message.y, message.z)
        elif isinstance(message, mav.GpsRawInt):
            time_s = message.time_usec * 1e-6
            if abs(time_s - self.latest_s) > _OTHER_CLOCK_S:  # some send the time of day here
                time_s = self.vehicle_time_s(heard.time_s)
            # The receiver's own velocity: the one in GLOBAL_POSITION_INT is bent by a bent compass.
            north, east, _ = telemetry.ground_velocity_mps(message).tolist()
            if north == north:
                self._column("gps_velocity_mps").add(time_s, north, east)
            if (yaw_rad := float(telemetry.second_antenna_rad(message))) == yaw_rad:
                self._column("gps_yaw_rad").add(time_s, yaw_rad)
        elif isinstance(message, mav.SystemTime):
            if message.time_unix_usec and message.time_boot_ms:
                self._utc_offset_s = message.time_unix_usec * 1e-6 - message.time_boot_ms * 1e-3
        else:
            self._add_without_clock(heard)

    def _add_imu(self, link_time_s: float, message: mav.RawImu | mav.ScaledImu) -> None:
        time_s = float(telemetry.imu_time_s(message))
        self._note_clock(link_time_s, time_s)
        self._imu[_IMU_MESSAGES[type(message)]].add(
            time_s,
            *(message.xmag, message.ymag, message.zmag),
            *(message.xacc, message.yacc, message.zacc),
            *(message.xgyro, message.ygyro, message.zgyro),
        )

    def _add_without_clock(self, heard: mav.Incoming) -> None:
        message, time_s = heard.message, self.vehicle_time_s(heard.time_s)
        if isinstance(message, mav.SysStatus):
            if message.current_battery >= 0:
                self._column("current_a").add(time_s, float(open_ended(message.current_battery)) * 0.01)
        elif isinstance(message, mav.VfrHud):
            self._column("throttle").add(time_s, message.throttle * 0.01)
        elif isinstance(message, mav.Simstate):
            self._column("truth_q").add(time_s, *quaternions_of(telemetry.euler_rad(message)[np.newaxis])[0])
        elif isinstance(message, mav.ParamValue):
            value, kind = message.param_value, message.param_type
            self.parameters[message.param_id] = number_told(value, kind) if self.autopilot == "px4" else value

    def _note_clock(self, link_time_s: float, vehicle_time_s: float) -> None:
        if vehicle_time_s < self.latest_s - 5.0:
            self.restarts += 1
            self._start_anew()
        self.latest_s = max(self.latest_s, vehicle_time_s)
        offset = link_time_s - vehicle_time_s
        self._offset_s = offset if self._offset_s is None else min(self._offset_s, offset)

    def _column(self, name: str) -> _Rows:
        return self._columns.setdefault(name, _Rows())

    def _compass(self, instance: int, columns: Series) -> MagSeries:
        rotation = self._rotations.get(instance)
        field_mgauss = open_ended(columns.values[:, 0:3])
        if rotation is not None:
            field_mgauss = turned_field(field_mgauss, rotation)
        if instance in self._turned:
            until_s, turned = self._turned[instance]
            before = columns.time_s[:, np.newaxis] <= until_s
            field_mgauss = np.where(before, turned_field(field_mgauss, turned), field_mgauss)
        steps = self._in_force.get(instance)
        return MagSeries(
            instance=instance,
            reported=Series(columns.time_s, np.asfortranarray(field_mgauss)),
            in_force=tuple(steps) if steps else (InForce(-np.inf, IDENTITY),),
            correction_known=steps is not None,
            quantum_mgauss=1.0,
            truncated=True,
            not_applied=self._not_applied.get(instance),
        )

    def take(self) -> Track:
        """Give the Track since the last `take` and keep nothing of it: for who listens for hours."""
        track = self.build()
        self._clear()
        return track

    def build(self) -> Track:
        """Give the Track of all that was heard since the vehicle's last start."""
        imu = {name: rows.series() for name, rows in self._imu.items()}
        compasses: dict[int, MagSeries] = {}
        body: Series | None = None
        # The denser of RAW_IMU and SCALED_IMU speaks for compass 1 and the body.
        for name, columns in sorted(imu.items(), key=lambda item: len(item[1] or ())):
            if columns is not None:
                instance = telemetry.MAG_MESSAGES[name]
                compasses[instance] = self._compass(instance, columns)
                if instance == 1:
                    body = columns
        columns_by_name: Mapping[str, Series | None] = {n: r.series() for n, r in self._columns.items()}
        track = Track(
            source=self.source,
            autopilot=self.autopilot,
            vehicle=self.vehicle,
            compasses=dict(sorted(compasses.items())),
            acc_mps2=_scaled(body, slice(3, 6), MPS2_PER_MILLI_G),
            gyro_radps=_scaled(body, slice(6, 9), RADPS_PER_MILLIRADPS),
            acc_truncation_mps2=MPS2_PER_MILLI_G,
            gyro_truncation_radps=RADPS_PER_MILLIRADPS,
            attitude_rad=columns_by_name.get("attitude_rad"),
            gps_yaw_rad=columns_by_name.get("gps_yaw_rad"),
            gps_velocity_mps=_over_ground(columns_by_name.get("gps_velocity_mps")),
            truth_q=columns_by_name.get("truth_q"),
            position_ned_m=columns_by_name.get("position_ned_m"),
            place=columns_by_name.get("place"),
            current_a=columns_by_name.get("current_a"),
            throttle=columns_by_name.get("throttle"),
            utc_offset_s=self._utc_offset_s,
            parameters=dict(self.parameters),
        )
        return with_sound_times(with_credible_readings(track))


def _over_ground(columns: Series | None) -> Series | None:
    """Add the velocity down, which GPS_RAW_INT does not tell, as nan."""
    if columns is None:
        return None
    return Series(columns.time_s, np.column_stack([columns.values, np.full(len(columns), np.nan)]))


def _scaled(columns: Series | None, which: slice, factor: float) -> Series | None:
    if columns is None:
        return None
    return Series(columns.time_s, np.asfortranarray(open_ended(columns.values[:, which]) * factor))


# The sparsest telemetry brings a few samples a second, of all quantities together, and one a second at least;
# an hour of silence costs nobody much.
_LONGEST_A_SAMPLE_S, _ALWAYS_S = 1.0, 3600.0
# IMUs are sampled at 32 kHz at most, and logged more slowly.
_SHORTEST_A_SAMPLE_S = 1e-5


def with_sound_times(track: Track) -> Track:
    """Return the track, or one without what has no clock, its silences shortened; the notes tell of it."""
    clockless = {name for name, series in _series(track) if _is_clockless(series.time_s)}
    if clockless:
        track = _without(track, clockless)
    all_times = [series.time_s for _, series in _series(track)]
    samples = sum(times.size for times in all_times)
    most_s = max(_ALWAYS_S, _LONGEST_A_SAMPLE_S * samples)
    ends = [(times[0], times[-1]) for times in all_times]
    if not ends or max(end for _, end in ends) - min(start for start, _ in ends) <= most_s:
        return track
    return _shortened(track, np.unique(np.concatenate(all_times)), most_s)


def _series(track: Track) -> list[tuple[str, Series]]:
    return [(name, series) for name, series in track.columns() if len(series)]


def _is_clockless(times: FloatArray) -> bool:
    return times.size > 1 and bool(times[-1] - times[0] < _SHORTEST_A_SAMPLE_S * (times.size - 1))


def _without(track: Track, clockless: set[str]) -> Track:
    kept = track.with_columns(lambda name, series: None if name in clockless else series)
    named = ", ".join(name.rpartition("_")[0] or name for name in sorted(clockless))
    note = f"Left out {named}: the times of its samples are one and the same, or closer than any sensor's."
    return replace(kept, notes=(*track.notes, note))


def _shortened(track: Track, moments: FloatArray, most_s: float) -> Track:
    """Shorten the longest silences between `moments`, sorted, until all lasts `most_s` at the most."""
    silences = np.diff(moments)
    longest_s = _longest(silences, most_s)
    kept = np.minimum(silences, longest_s)
    # From the side where most was said, so that most times stay what they were.
    middle = int(np.searchsorted(moments, np.median(np.concatenate([s.time_s for _, s in _series(track)]))))
    since = np.concatenate([[0.0], np.cumsum(kept)])
    placed = since - since[middle]
    # So far from a boot that its numbers have no room for single samples, a time says nothing.
    if np.spacing(abs(moments[middle])) < _SHORTEST_A_SAMPLE_S:
        placed += moments[middle]

    def moved(times: FloatArray) -> FloatArray:
        return np.asarray(np.interp(times, moments, placed))

    count = int(np.count_nonzero(silences > longest_s))
    note = (
        f"{count} silences were shortened to {longest_s:.0f} s: the times of {moments.size} samples span"
        f" {moments[-1] - moments[0]:.3g} s, which is longer than they can carry."
    )
    return replace(track.with_times(moved), notes=(*track.notes, note))


def _longest(silences: FloatArray, most_s: float) -> float:
    """Return the length L such that silences, none longer than L, last `most_s` together."""
    ordered = np.sort(silences)
    # With the k shortest as they are, the others have (most - their sum) / (n - k) each.
    before = np.concatenate([[0.0], np.cumsum(ordered)[:-1]])
    share = (most_s - before) / np.arange(ordered.size, 0, -1)
    return float(share[np.argmax(share < ordered)])
