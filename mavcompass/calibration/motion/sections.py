"""Cut a motion into sections: stretches with nearly one heading, tilt and current, each with its mean field.

The mean of the field over a section that turns and tilts a little is exact all the same,

    mean r = b + T A (H cos psi, -H sin psi, Z) + m I,     A = mean of L R(turned - middle)         (S1)

with L from level to body axes and R the gyro's turn inside the section; `psi` is the heading at its middle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mavcompass.attitude import Levels, levels
from mavcompass.calibration.observation.dwells import TILT_BIAS_SIGMA_RAD
from mavcompass.calibration.observation.turning import (
    DRIFT_RADPS2,
    DRIFTS_FOR_S,
    GYRO_SCALE_SIGMA,
    SPARSE_RAD,
    TurnRecord,
    too_sparse,
)
from mavcompass.calibration.observation.wire import fresh_readings, hidden_in_runs
from mavcompass.calibration.rigid import Readings
from mavcompass.errors import PoorCalibration
from mavcompass.frames import FloatArray, level_to_body, quaternion_to_matrix, tilt_from_acceleration
from mavcompass.track import Series, Track

_WIDEST_TURN_RAD = math.radians(20.0)
_WIDEST_TILT = math.sin(math.radians(7.0))
_LONGEST_S = 5.0
_LONGEST_GAP_S = 1.0
_MOST_SECTIONS = 160
# The cutting looks at means over this time; inside a section every reading counts.
_GRAIN_S = 0.1
_LEAST_NOISE_MGAUSS, _USUAL_NOISE_MGAUSS = 0.2, 3.0
# Readings further apart show motion between them, not noise; a gyro's then miss what the vehicle did.
_SPARSE_S, _WORST_SPARSE = 0.2, 5.0
_DENSE_S = 0.1
_LOAD_STEP = 0.15
_PARAMETERS_SETTLE_S = 2.0
# Less of the circle than this cannot tell iron from heading.
LEAST_CIRCLE_RAD = math.radians(150.0)
# One sigma of a reference's yaw, and how often it has to be told.
_OPTICAL_SIGMA_RAD, _GPS_SIGMA_RAD = math.radians(0.3), math.radians(0.7)
_FEWEST = 10


@dataclass(frozen=True, slots=True, eq=False)
class Sections(Readings):
    """Hold K sections of one compass's recording, in time order, as readings of equation S1.

    Attributes:
        start_s, end_s: (K,). samples: fresh readings, (K,).
        noise_mgauss: white noise of one reading. hidden_mgauss: by whole numbers, in each mean, (K, 3).
        tilt_sigma_rad: what is not known of roll and pitch, (K,).
        tilt_bias_rad: what its source is off by all along, 1 sigma.
        bias_sigma_radps, scale_sigma: of the gyro, common to all.
        loads_mean: what was taken off the L loads; all are zero where none was recorded, L is 1 then.
        repeats: how many sections make one visit of a heading, (K,): they share what is wrong there.
        gyro_rate_hz: how often the rate was recorded.
    """

    start_s: FloatArray
    end_s: FloatArray
    samples: FloatArray
    noise_mgauss: float
    hidden_mgauss: FloatArray
    tilt_sigma_rad: FloatArray
    tilt_bias_rad: float
    bias_sigma_radps: float
    scale_sigma: float
    loads_mean: tuple[float, ...]
    repeats: FloatArray
    gyro_rate_hz: float

    def sparse(self, least_rad: float = SPARSE_RAD) -> PoorCalibration | None:
        """Say that the gyro was recorded too seldom to follow the turns, see `too_sparse`; None if not."""
        return too_sparse(np.diff(self.turned_rad), self.step_sigma_rad, self.gyro_rate_hz, least_rad)

    def between(self, start_s: float, end_s: float) -> Sections:
        """Keep the sections whose middle lies between two times."""
        return self.chosen(np.arange(*np.searchsorted(self.middle_s, [start_s, end_s])))

    def of_loads(self, kept: slice) -> Sections:
        """Keep some of the loads."""
        return replace(self, loads=self.loads[:, kept], loads_mean=self.loads_mean[kept])

    def chosen(self, kept: NDArray[np.intp]) -> Sections:
        """Keep some of the sections, in their order; the turns between them are joined."""
        cut = {
            f.name: value[kept]
            for f in fields(self)
            if isinstance(value := getattr(self, f.name), np.ndarray) and f.name != "step_sigma_rad"
        }
        steps = np.empty(0)
        if len(kept) > 1:
            steps = np.sqrt(np.add.reduceat(self.step_sigma_rad[: kept[-1]] ** 2, kept[:-1]))
        return replace(self, **cut, step_sigma_rad=steps)  # type: ignore[arg-type]


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
    interval_s = float(np.median(np.diff(time)))
    return TurnRecord(time, yaw, np.gradient(yaw, time), np.zeros(time.size), interval_s=interval_s)


def cut_sections(
    track: Track,
    instance: int,
    record: TurnRecord,
    raw_mgauss: FloatArray,
    load: FloatArray | None = None,
    reference: ReferenceTurn | None = None,
) -> Sections:
    """Cut the motion of one compass into sections.

    Args:
        track: the recording.
        instance: the compass.
        record: the gyro's turn, or an attitude reference's in its place.
        raw_mgauss: (N, 3), at the compass's times.
        load: motor load, (N,), or several, (N, L).
        reference: the attitude reference that `record` comes from.
    """

    level = levels(track) if reference is None else reference.levels(track)
    compass = track.compasses[instance]
    time = compass.time_s
    usable = np.isfinite(raw_mgauss).all(axis=1)
    usable &= (time >= record.time_s[0]) & (time <= record.time_s[-1])
    usable[1:] &= np.diff(time) > 0.0
    usable &= ~unsettled(track, instance)
    time, raw = time[usable], raw_mgauss[usable]
    loads = np.zeros((time.size, 1)) if load is None else load[usable].reshape(time.size, -1)
    lag = track.field_lag_s
    angle = record.angle_at(time - lag)
    level = leaning_as_seen(level, time - lag)
    down = level.at(time - lag)
    edges, visit = _edges(time, angle, down, loads)
    first, last = edges[:-1], edges[1:]
    fresh = fresh_readings(raw)
    count = (last - first).astype(float)

    def mean(values: FloatArray) -> FloatArray:
        total = np.add.reduceat(values, first, axis=0)
        return total / count.reshape(-1, *[1] * (values.ndim - 1))

    turned = mean(angle)
    section = np.repeat(np.arange(len(first)), last - first)
    mapping = level_to_body(*tilt_from_acceleration(-down), angle - turned[section])
    later = 0.02
    leaning = tilt_from_acceleration(-level.at(time - lag - later))
    moved = level_to_body(*leaning, record.angle_at(time - lag - later) - turned[section])
    middle = 0.5 * (time[first] + time[last - 1])
    steps = np.diff(middle)
    middle_load = np.array([column.mean() if column.size else 0.0 for column in loads.T])
    if reference is None:
        white = np.array([_step_sigma(record, a, b) for a, b in pairwise(middle)])
        # What is not known of the bias is common to all but for its drift.
        drift = DRIFT_RADPS2 * min(float(time[-1] - time[0]), DRIFTS_FOR_S) if time.size else 0.0
        sigma = np.hypot(white, min(drift, record.bias_sigma_radps) * steps)
    else:
        sigma = np.full(steps.size, math.sqrt(2.0) * reference.sigma_rad)
    return Sections(
        middle_s=middle,
        start_s=time[first],
        end_s=time[last - 1],
        mean_mgauss=mean(raw),
        samples=np.maximum(np.add.reduceat(fresh.astype(float), first), 1.0),
        noise_mgauss=_white_noise(time[fresh], raw[fresh], compass.quantum_mgauss),
        hidden_mgauss=hidden_in_runs(compass.reported.values[usable], first, compass.quantum_mgauss),
        mapping=mean(mapping),
        by_lag=(mean(moved) - mean(mapping)) / later,
        tilt_sigma_rad=np.sqrt(mean(level.sigma_rad.at(time - lag) ** 2)),
        tilt_bias_rad=TILT_BIAS_SIGMA_RAD if reference is None else 0.0,
        turned_rad=turned,
        step_sigma_rad=sigma,
        bias_sigma_radps=record.bias_sigma_radps,
        scale_sigma=GYRO_SCALE_SIGMA if reference is None else 1e-9,
        loads=mean(loads) - middle_load,
        loads_mean=tuple(middle_load.tolist()),
        repeats=np.bincount(visit)[visit].astype(float),
        gyro_rate_hz=record.rate_hz,
    )


def unsettled(track: Track, instance: int) -> NDArray[np.bool_]:
    """Mark readings around a change of the parameters, (N,): these take force one by one, and told late."""
    compass = track.compasses[instance]
    steps = np.array([step.from_s for step in compass.in_force[1:]])
    nearest = np.abs(compass.time_s[:, np.newaxis] - steps).min(axis=1, initial=math.inf)
    return np.asarray(nearest < _PARAMETERS_SETTLE_S)


def leaning_as_seen(level: Levels, time_s: FloatArray) -> Levels:
    """Shrink what roll and pitch move by to what is more than their own error (errors in variables).

    Noise in a lean that the field does not follow would be taken for a gain of the vertical axis.
    """
    down = level.at(time_s)
    middle = down.mean(axis=0) if time_s.size else np.zeros(3)
    moved2 = float(((down - middle) ** 2).sum(axis=1).mean()) / 2.0 if time_s.size else 0.0
    own2 = float((level.sigma_rad.at(time_s) ** 2).mean()) if time_s.size else 0.0
    seen = max(1.0 - own2 / max(moved2, 1e-12), 0.0)
    return replace(level, down=Series(level.down.time_s, middle + seen * (level.down.values - middle)))


def _step_sigma(record: TurnRecord, start_s: float, end_s: float) -> float:
    missed = min(max(record.interval_s / _DENSE_S, 1.0), _WORST_SPARSE)
    sigma = missed * record.independent_sigma_rad(start_s, end_s)
    return max(min(sigma, math.pi), math.radians(0.02))


def _edges(
    time: FloatArray, angle: FloatArray, down: FloatArray, load: FloatArray
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return where sections begin, and the end, so that none turns, tilts or lasts long; and their visits."""
    if time.size < 2:
        return np.zeros(1, dtype=np.intp), np.zeros(0, dtype=np.intp)
    grain = np.concatenate([[0], np.flatnonzero(np.diff(np.floor(time / _GRAIN_S))) + 1])
    longest = max(_LONGEST_S, float(time[-1] - time[0]) / (0.5 * _MOST_SECTIONS))
    widest, tilt, gap = (
        _WIDEST_TURN_RAD,
        _WIDEST_TILT,
        max(_LONGEST_GAP_S, 3.0 * float(np.median(np.diff(time)))),
    )
    step = _LOAD_STEP * np.maximum(np.ptp(load, axis=0), 1e-9) + 1e-9
    while True:
        limits = (longest, widest, tilt, gap)
        edges, visit = _greedy(time, angle, down, load, grain, limits, step.tolist())
        if len(visit) <= _MOST_SECTIONS:
            return edges, visit
        widest, tilt, step, longest, gap = 1.2 * widest, 1.25 * tilt, 1.25 * step, 1.1 * longest, 1.25 * gap


def _greedy(
    time: FloatArray,
    angle: FloatArray,
    down: FloatArray,
    load: FloatArray,
    grain: NDArray[np.intp],
    limits: tuple[float, float, float, float],
    steps: list[float],
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    longest, widest, tilt, gap = limits
    t, a, i, d = time[grain].tolist(), angle[grain].tolist(), load[grain].tolist(), down[grain].tolist()
    edges, visit = [0], [0]
    begun, low, high, lean, current, before = t[0], a[0], a[0], d[0], i[0], t[0]
    for k in range(1, len(t)):
        low, high = min(low, a[k]), max(high, a[k])
        leaning = sum((p - q) ** 2 for p, q in zip(d[k], lean, strict=True)) > tilt**2
        stepped = any(abs(p - q) > step for p, q, step in zip(i[k], current, steps, strict=True))
        moved = high - low > widest or leaning or stepped or t[k] - before > gap
        if moved or t[k] - begun > longest:
            edges.append(int(grain[k]))
            visit.append(visit[-1] + moved)
            begun = t[k]
        if moved:
            low, high, lean, current = a[k], a[k], d[k], i[k]
        before = t[k]
    return np.array([*edges, time.size], dtype=np.intp), np.array(visit, dtype=np.intp)


def _white_noise(time: FloatArray, raw: FloatArray, quantum_mgauss: float) -> float:
    """Return the noise of one reading by third differences, which a smooth turn hardly shows."""
    least = math.hypot(_LEAST_NOISE_MGAUSS, quantum_mgauss / math.sqrt(12.0))
    if len(raw) < 8 or float(np.median(np.diff(time))) > _SPARSE_S:
        return max(least, _USUAL_NOISE_MGAUSS)
    bends = np.abs(np.diff(raw, 3, axis=0))
    return max(float(np.median(bends)) / (0.6745 * math.sqrt(20.0)), least)
