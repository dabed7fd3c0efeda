"""The world about a recording: the field at its place, and what it contains of the needs of effects."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mavcompass.earth_field import decimal_year, earth_field, middle_place
from mavcompass.errors import BadRecording
from mavcompass.frames import FloatArray, rotate
from mavcompass.gap.attitude.kinematics import averaged
from mavcompass.gap.attitude.reference import Reference
from mavcompass.gap.attitude.sensors import local_position
from mavcompass.gap.tables import usual
from mavcompass.simulation.physics.signals import Stimulus
from mavcompass.track import MagSeries, Series, Track


def position_of(track: Track, reference: Reference) -> Series | None:
    """Return the best position there is: measured, or the receiver's where the vehicle goes far enough."""
    measured = track.position_ned_m
    if measured is not None and len(measured) > 1:
        return without_scatter(measured)
    received = local_position(track.place)
    return without_scatter(received) if received and goes_about(received, reference) else None


def without_scatter(position: Series) -> Series:
    """Return a path without what scatters from place to place, which no mass does.

    Parabolas are fitted to neighbours (Savitzky and Golay, Analytical Chemistry 36, 1964), fewer of them
    until what is left does not go on from one to the next: where it does, it is the path's own.
    """
    half = int(usual.receiver.smooth_s / max(float(np.median(np.diff(position.time_s))), 1e-3))
    while 2 <= half < len(position) // 2:
        weights = np.linalg.pinv(np.vander(np.arange(-half, half + 1.0), 3, increasing=True))[0]
        padded = np.pad(position.values, ((half, half), (0, 0)), mode="reflect", reflect_type="odd")
        smooth = np.stack([np.convolve(axis, weights, "valid") for axis in padded.T], axis=1)
        left = position.values - smooth
        if np.sum(left[1:] * left[:-1]) <= 0.0:
            return Series.of(position.time_s, smooth)
        half //= 2
    return position


def goes_about(position: Series | None, reference: Reference) -> bool:
    """Tell whether a path is longer than its errors, which an independent reference does not have."""
    if position is None or not np.isfinite(position.values).all(axis=1).any():
        return False
    spread = np.nanstd(position.values, axis=0)
    if reference.kind == "columns":
        return float(spread.max()) > usual.present.path_m
    return float(spread.max()) > usual.receiver.path_m


def present_in(
    stimulus: Stimulus, reference: Reference, goes_about: bool, valid: NDArray[np.bool_]
) -> frozenset[str]:
    """List what a recording contains of the needs of effects, its `valid` rows (N,) of motion.

    `goes_about` tells whether its path is longer than the errors of its places.
    """
    present = set()
    for name, values in stimulus.loads.items():
        if (
            np.isfinite(values).any()
            and float(np.ptp(values[np.isfinite(values)])) > usual.present.load[name]
        ):
            present.add(name)
    if stimulus.motors.size and float(np.ptp(stimulus.motors, axis=0).max()) > usual.present.load["throttle"]:
        present.add("motors")
    if goes_about:
        present.add("position")
    if float(np.ptp(stimulus.position_ned_m[:, 2])) > usual.present.climb_m:
        present.add("height")
    rotation = stimulus.rotation[valid]
    if len(rotation):
        ahead = rotation[:, :2, 0] / np.maximum(np.linalg.norm(rotation[:, :2, 0], axis=1), 1e-9)[:, None]
        if float(np.hypot(*np.mean(ahead, axis=0))) < math.cos(usual.present.turning_rad):
            present.add("turning")
        spread = np.sqrt(np.var(rotation[:, 2, 0]) + np.var(rotation[:, 2, 1]))
        if spread > math.sin(usual.present.tilt_rad):
            present.add("tilt")
    if reference.kind == "columns":
        present.add("reference")
    return frozenset(present)


def world_field(
    track: Track, instance: int, time_s: FloatArray, reference: Reference, raw: FloatArray
) -> tuple[FloatArray, FloatArray, tuple[str, ...]]:
    """Return the field in NED, its sigma, and what to say about it."""
    if track.place is not None and np.isfinite(track.place.values).all(axis=1).any():
        lat, lon, alt = middle_place(track.place.values)
        year = decimal_year(track.utc_offset_s) if track.utc_offset_s else usual.place.year
        earth = earth_field(round(lat, 5), round(lon, 5), round(alt, 1), round(year, 3))
        refined = _measured_by_others(track, instance, time_s, reference, earth.vector_mgauss)
        if refined is not None:
            note = "The vehicle's other compasses agree with the world model; they give the local field."
            return (
                refined,
                np.array([usual.others.local_mgauss, earth.sigma_mgauss[1], usual.others.local_mgauss]),
                (note,),
            )
        # Beside a laboratory's attitude what rocks and buildings add shows itself, and is judged as a cause.
        share = 0.0 if reference.kind == "columns" else usual.place.anomaly
        anomaly = share * float(np.linalg.norm(earth.vector_mgauss))
        return earth.vector_mgauss, np.hypot(np.asarray(earth.sigma_mgauss), anomaly), ()
    rows = reference.known & np.isfinite(raw).all(axis=1)
    if not rows.any():
        raise BadRecording(
            "The attitude reference and the compass never speak at the same time.",
            "Choose another with --reference, or record both together.",
        )
    field = np.median(rotate(reference.rotation[rows], raw[rows]), axis=0)
    note = (
        "The recording does not say where it was made: the field is estimated from it, so that the field's"
        " intensity, inclination and declination cannot be judged."
    )
    return field, np.full(3, usual.place.unknown_mgauss), (note,)


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
        if number == instance or not compass.correction_known or len(compass.reported) < usual.rows.fewest:
            continue
        values = track.centred(number).corrected_field(number)
        world = rotate(
            reference.rotation[reference.known], Series.of(compass.time_s, values).at(time_s)[reference.known]
        )
        parts = np.array([np.median(np.hypot(world[:, 0], world[:, 1])), np.median(world[:, 2])])
        spread = 1.4826 * np.median(np.abs(np.hypot(world[:, 0], world[:, 1]) - parts[0]))
        if (
            spread < usual.others.steady_mgauss
            and np.abs(parts - (level, model[2])).max() < usual.others.agree_mgauss
        ):
            seen.append(parts)
    if len(seen) < 2 or float(np.ptp(np.array(seen), axis=0).max()) > 2.0 * usual.others.local_mgauss:
        return None
    horizontal, down = np.mean(seen, axis=0)
    return np.array([model[0] * horizontal / level, model[1] * horizontal / level, down])


def compass_of(track: Track, instance: int) -> MagSeries:
    """Return a compass with one load of its motors at most. Raises BadRecording where there is none."""
    if instance not in track.compasses:
        have = ", ".join(str(i) for i in sorted(track.compasses)) or "none"
        raise BadRecording(
            f"{track.source or 'The recording'} has no compass {instance} (it has {have}).",
            "Choose one of them with --compass.",
        )
    compass = track.compasses[instance]
    # What each motor has by itself stays taken out of the readings: the iron has one load at most.
    left = tuple(replace(step, correction=step.correction.without_outputs()) for step in compass.in_force)
    return replace(compass, in_force=left)


def place_of(track: Track) -> tuple[float, float, float] | None:
    """Return latitude, longitude and altitude in the middle of a recording's places."""
    if track.place is None or not np.isfinite(track.place.values).all(axis=1).any():
        return None
    return middle_place(track.place.values)


def every_s(*series: Series | None) -> float:
    """Return the usual time between the rows of the slowest of some series; zero where none was recorded."""
    return max(
        (float(np.median(np.diff(s.time_s))) for s in series if s is not None and len(s) > 1), default=0.0
    )


def column(
    series: Series | None, time_s: FloatArray, width: int = 1, clock: FloatArray | None = None
) -> FloatArray:
    """Return what was recorded of a vector at some times (N,), (N, 3); where readings are averaged over some
    `width` of their `clock`, means that are as wide: their times vary by as much."""
    if series is None or len(series) < 2:
        return np.full((time_s.size, 3), np.nan)
    if width > 1 and clock is not None and np.isfinite(series.values).all():
        finer = float(np.median(np.diff(clock)) / np.median(np.diff(series.time_s)))
        as_wide = 2 * int(0.5 * math.sqrt(1.0 + (width**2 - 1.0) * finer**2)) + 1
        series = Series.of(series.time_s, averaged(series.values, as_wide))
    return np.ascontiguousarray(series.at(time_s))


def scalar(series: Series | None, time_s: FloatArray) -> FloatArray:
    """Return what was recorded of a load at some times, (N,); not numbers where nothing was."""
    if series is None or not np.isfinite(series.values).any():
        return np.full(time_s.size, np.nan)
    finite = np.isfinite(series.values)
    return np.interp(time_s, series.time_s[finite], series.values[finite])
