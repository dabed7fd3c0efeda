"""An attitude that owes nothing to a compass, in place of the gyro's turn: optical, turntable, GPS."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mavcompass.attitude import Levels, levels
from mavcompass.calibration.observation.turning import TurnRecord
from mavcompass.frames import FloatArray, quaternion_to_matrix
from mavcompass.track import Series, Track

_OPTICAL_SIGMA_RAD, _GPS_SIGMA_RAD = math.radians(0.3), math.radians(0.7)
_FEWEST = 10


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceTurn:
    """Hold a reference's true yaw as a turn, what is not known of it, and its tilt."""

    record: TurnRecord
    sigma_rad: float
    own: Levels | None = None

    def levels(self, track: Track) -> Levels:
        """Return roll and pitch by the reference, or by the recording where it tells yaw only."""
        return self.own or levels(track)


def reference_turn(track: Track) -> ReferenceTurn | None:
    """Return the recording's reference as a turn; None where it has none."""
    if track.reference_q is not None and len(track.reference_q) >= _FEWEST:
        time, q = track.reference_q.time_s, np.asarray(track.reference_q.values)
        to_world = quaternion_to_matrix(q / np.linalg.norm(q, axis=1, keepdims=True))
        yaw = np.unwrap(np.arctan2(to_world[:, 1, 0], to_world[:, 0, 0]))
        sigma = Series.of(time, np.full(time.size, _OPTICAL_SIGMA_RAD))
        return ReferenceTurn(
            _record(time, yaw), _OPTICAL_SIGMA_RAD, Levels(Series.of(time, to_world[:, 2, :]), sigma)
        )
    if track.gps_yaw_rad is None:
        return None
    known = np.isfinite(track.gps_yaw_rad.values)
    if int(known.sum()) < _FEWEST:
        return None
    return ReferenceTurn(
        _record(track.gps_yaw_rad.time_s[known], np.unwrap(track.gps_yaw_rad.values[known])), _GPS_SIGMA_RAD
    )


def _record(time: FloatArray, yaw: FloatArray) -> TurnRecord:
    return TurnRecord(
        time_s=time,
        angle_rad=yaw,
        rate_radps=np.gradient(yaw, time),
        tilt_rate_radps=np.zeros(time.size),
        bias_radps=0.0,
        bias_sigma_radps=1e-9,
        noise_radps=0.0,
        walk_rad=0.0,
        interval_s=float(np.median(np.diff(time))),
    )
