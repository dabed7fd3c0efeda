"""The motion of a recording, as a simulated vehicle of the same class can be asked for it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mavcompass.errors import BadRecording
from mavcompass.frames import FloatArray, matrix_to_euler, quaternion_to_matrix
from mavcompass.track import Series, Track

FLOWN = ("rover", "boat", "copter")
_STEP_S = 0.1
_SHORTEST_S = 10.0
_METRES_PER_DEG = 111_195.0
# A copter is asked for no height at which it would land.
_LOWEST_M = 2.0
# Turning so much at less than that speed, a vehicle turns on the spot.
_PIVOT_RADPS, _PIVOT_MPS, _PIVOT_S = math.radians(6.0), 0.15, 3.0
# Yaw is smoothed over so long before its rate is taken: an autopilot's jumps are no turns.
_SMOOTH_S = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Profile:
    """Hold a motion on a grid of time.

    Attributes:
        kind: "rover", "boat" or "copter".
        time_s: (N,), from 0. yaw_rad: unwrapped, (N,); yaw_rate_radps: (N,).
        velocity_mps: north, east, down, (N, 3). position_m: north, east, down of the home, (N, 3).
        home: latitude deg, longitude deg, altitude m; None where the recording tells no place.
        rate_hz: how often its compass was recorded.
        utc_s: Unix time of its begin; None where unknown.
    """

    kind: str
    time_s: FloatArray
    yaw_rad: FloatArray
    yaw_rate_radps: FloatArray
    velocity_mps: FloatArray
    position_m: FloatArray
    home: tuple[float, float, float] | None
    rate_hz: float
    utc_s: float | None

    @property
    def duration_s(self) -> float:
        """Return how long it lasts."""
        return float(self.time_s[-1])

    @property
    def forward_mps(self) -> FloatArray:
        """Return the speed along the nose, (N,)."""
        north, east = self.velocity_mps[:, 0], self.velocity_mps[:, 1]
        return north * np.cos(self.yaw_rad) + east * np.sin(self.yaw_rad)

    @property
    def pivots(self) -> bool:
        """Tell whether the vehicle turned on the spot, which one that steers its wheels cannot."""
        still = (np.abs(self.forward_mps) < _PIVOT_MPS) & (np.abs(self.yaw_rate_radps) > _PIVOT_RADPS)
        return bool(np.count_nonzero(still) * _STEP_S > _PIVOT_S)

    def at(self, time_s: float) -> int:
        """Return the index of a time, that of the nearest end outside."""
        return int(np.clip(round(time_s / _STEP_S), 0, self.time_s.size - 1))


def profile_of(track: Track, instance: int = 1, longest_s: float = math.inf) -> Profile:
    """Take the motion out of a recording: its yaw, speed and place, from its compass's first reading on.

    Raises BadRecording where it tells no attitude, is too short, or is of a vehicle that is not flown again.
    """
    if track.vehicle not in FLOWN:
        raise BadRecording(
            f"The recording is of a vehicle of the kind {track.vehicle!r}; its motion cannot be flown again.",
            f"Give a recording of one of {', '.join(FLOWN)}, or fly the simulator yourself and use"
            " `mavcompass gap compare`.",
        )
    yaw = _yaw(track)
    compass = track.compasses.get(instance)
    if yaw is None or compass is None or len(compass.reported) < 2:
        lacking = "attitude" if yaw is None else f"compass {instance}"
        raise BadRecording(
            f"The recording tells no {lacking}, so its motion is not known.",
            "Record ATTITUDE and RAW_IMU (or ATT and MAG in the autopilot's own log) and try again.",
        )
    start_s = max(float(yaw.time_s[0]), float(compass.time_s[0]))
    end_s = min(float(yaw.time_s[-1]), float(compass.time_s[-1]), start_s + longest_s)
    if end_s - start_s < _SHORTEST_S:
        raise BadRecording(
            f"The recording has {max(end_s - start_s, 0.0):.0f} s with attitude and compass.",
            f"Flying it again is worth while from {_SHORTEST_S:.0f} s on: give a longer one.",
        )
    time_s = np.arange(0.0, end_s - start_s, _STEP_S)
    yaw_rad = _smoothed(yaw.at(time_s + start_s))
    velocity = np.zeros((time_s.size, 3))
    if track.gps_velocity_mps is not None and len(track.gps_velocity_mps):
        velocity = track.gps_velocity_mps.at(time_s + start_s)
    position, home = _position(track, time_s + start_s, velocity)
    return Profile(
        kind=track.vehicle,
        time_s=time_s,
        yaw_rad=yaw_rad,
        yaw_rate_radps=np.gradient(yaw_rad, _STEP_S),
        velocity_mps=velocity,
        position_m=position,
        home=home,
        rate_hz=(len(compass.reported) - 1) / float(compass.time_s[-1] - compass.time_s[0]),
        utc_s=None if track.utc_offset_s is None else track.utc_offset_s + start_s,
    )


def _yaw(track: Track) -> Series | None:
    """Return the yaw over time, unwrapped."""
    if track.reference_q is not None and len(track.reference_q) > 1:
        _, _, yaw = matrix_to_euler(quaternion_to_matrix(track.reference_q.values))
        return Series.of(track.reference_q.time_s, np.unwrap(yaw))
    if track.attitude_rad is not None and len(track.attitude_rad) > 1:
        return Series.of(track.attitude_rad.time_s, np.unwrap(track.attitude_rad.values[:, 2]))
    return None


def _smoothed(values: FloatArray) -> FloatArray:
    """Return running means; the ends are held."""
    half = round(_SMOOTH_S / _STEP_S / 2.0)
    padded = np.pad(values, half, mode="edge")
    width = 2 * half + 1
    return np.convolve(padded, np.full(width, 1.0 / width), mode="valid")


def _position(
    track: Track, time_s: FloatArray, velocity_mps: FloatArray
) -> tuple[FloatArray, tuple[float, float, float] | None]:
    """Return where the vehicle was (N, 3), and the home from which that is counted.

    The home lies on the ground: below the first place, as deep as the autopilot says that it flies, or, where
    it does not say, so that the lowest place lies above the ground.
    """
    local = track.position_ned_m
    place = None if track.place is None or not len(track.place) else track.place.at(time_s)
    if local is not None and len(local):
        position = local.at(time_s)
    elif place is not None:
        north_east = (place[:, :2] - place[0, :2]) * _METRES_PER_DEG
        north_east[:, 1] *= math.cos(math.radians(place[0, 0]))
        position = np.column_stack([north_east, place[:, 2].min() - place[:, 2]])
        position[:, 2] -= _LOWEST_M
    else:
        position = np.cumsum(velocity_mps, axis=0) * _STEP_S
        position[:, 2] += -_LOWEST_M - position[:, 2].max()
    home = None
    if place is not None:
        north, east, down = position[0]
        lat = place[0, 0] - north / _METRES_PER_DEG
        lon = place[0, 1] - east / (_METRES_PER_DEG * math.cos(math.radians(place[0, 0])))
        home = float(lat), float(lon), float(place[0, 2] + down)
    if track.vehicle == "copter":
        position[:, 2] = np.minimum(position[:, 2], -_LOWEST_M)
    return position, home
