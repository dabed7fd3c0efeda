"""Calibrate a compass from a recording, by any of the methods."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mavcompass.blas import single_thread
from mavcompass.calibration.methods import find_method
from mavcompass.calibration.methods.running import Learnt, learn
from mavcompass.calibration.recorded import Recorded
from mavcompass.calibration.result import CalibrationResult
from mavcompass.calibration.verdict import DEFAULT_LIMITS, Limits
from mavcompass.compass_parameters import values
from mavcompass.earth_field import EarthField, earth_field_of
from mavcompass.errors import BadRecording, PoorCalibration
from mavcompass.frames import circular_mean
from mavcompass.heading.stream import HeadingResult, heading_of_track
from mavcompass.parameter_remarks import remarks_said
from mavcompass.track import Track

_DEAD_SWING_MGAUSS = 3.0
_TURNED_RAD = math.radians(30.0)
# A slower rate may be the gyro's bias, which in minutes of standing adds up to a turn.
_BIAS_RADPS = math.radians(3.0)
# Tried where another method refused.
_OTHERS = ("four-positions", "world-field", "ellipsoid")


@single_thread()
def calibrate_track(
    track: Track,
    method: str = "auto",
    instance: int = 1,
    *,
    limits: Limits = DEFAULT_LIMITS,
    earth: EarthField | None = None,
    use_world_model: bool = True,
    windows: Sequence[tuple[float, float]] | None = None,
) -> CalibrationResult:
    """Calibrate one compass of a recording.

    Args:
        track: the recording.
        method: one of `methods.method_names()`.
        instance: the compass, counting from 1.
        limits: what is accepted.
        earth: the Earth's field; None takes it from the recording's place and date.
        use_world_model: False leaves scale and Z alone even where the place is known.
        windows: the still stretches (start, end) for four-positions; None finds them.

    Raises BadRecording where the compass is missing, PoorCalibration where the recording cannot give a
    calibration at all (too little motion, a dead compass), UsageError for an unknown method. A result
    that is not worth writing comes back with `accepted` False and its reasons.
    """
    solve = find_method(method)
    _check_compass(track, instance)
    world = (earth or earth_field_of(track)) if use_world_model else None
    recorded = Recorded(track, instance, world, limits, windows=windows)
    result = solve(recorded)
    if not result.accepted and windows is None and method != "auto":
        result = replace(result, warnings=(*result.warnings, *_would_do(recorded, result.method)))
    return with_parameters(result, track)


@single_thread()
def learn_compass(
    track: Track, instance: int, earth: EarthField | None, limits: Limits = DEFAULT_LIMITS
) -> Learnt:
    """Tell what some minutes of work show of one compass.

    Raises BadRecording where the compass is missing, PoorCalibration where there is nothing to learn from.
    """
    _check_compass(track, instance)
    learnt = learn(Recorded(track, instance, earth, limits))
    return replace(learnt, result=with_parameters(learnt.result, track))


def _would_do(recorded: Recorded, refused: str) -> tuple[str, ...]:
    """Name the methods that would accept what one refused."""
    return tuple(
        f"--method {name} would accept this recording: heading within {other.heading_sigma_deg:.1f} deg."
        for name in _OTHERS
        if name != refused and (other := _accepted(recorded, name)) is not None
    )


def _accepted(recorded: Recorded, method: str) -> CalibrationResult | None:
    try:
        result = find_method(method)(recorded)
    except PoorCalibration:
        return None
    return result if result.accepted else None


def calibrate_compasses(
    track: Track,
    method: str = "auto",
    instances: tuple[int, ...] | None = None,
    *,
    limits: Limits = DEFAULT_LIMITS,
    earth: EarthField | None = None,
) -> dict[int, CalibrationResult]:
    """Calibrate several compasses of one recording (None: all) and hold their headings against each other.

    A compass whose heading is turned against that of the others, all of them calibrated, is refused: it is
    mounted turned. With only two, both are told so. One without a solution is refused with its reason.
    Raises what `calibrate_track` raises, PoorCalibration only where no compass has a solution.
    """
    chosen = tuple(sorted(track.compasses)) if instances is None else instances
    results: dict[int, CalibrationResult] = {}
    refusals: list[PoorCalibration] = []
    for i in chosen:
        try:
            results[i] = calibrate_track(track, method, i, limits=limits, earth=earth)
        except PoorCalibration as refusal:
            refusals.append(refusal)
            results[i] = _refused(track, method, i, refusal)
    if refusals and len(refusals) == len(chosen):
        raise refusals[0]
    headings = {
        i: heading_of_track(track, result.correction, i) for i, result in results.items() if result.accepted
    }
    return {i: _held_against(result, i, headings) for i, result in results.items()}


def _refused(track: Track, method: str, instance: int, refusal: PoorCalibration) -> CalibrationResult:
    """Keep what is in force for a compass that the recording cannot calibrate."""
    in_force = Recorded(track, instance).in_force
    return CalibrationResult(
        instance=instance,
        method=method,
        accepted=False,
        reasons=(str(refusal),),
        raw_offset_mgauss=-np.asarray(in_force.offsets_mgauss),
        correction=in_force,
        in_force=in_force,
    )


def _held_against(
    result: CalibrationResult, instance: int, headings: dict[int, HeadingResult]
) -> CalibrationResult:
    """Refuse a calibration whose heading is turned against all other accepted ones."""
    mine = headings.get(instance)
    others = {i: h for i, h in headings.items() if i != instance}
    if mine is None or not others:
        return result
    turned = {}
    for i, other in others.items():
        nearest = np.clip(np.searchsorted(other.time_s, mine.time_s), 0, other.time_s.size - 1)
        turned[i] = circular_mean(mine.magnetic_rad - other.magnetic_rad[nearest])
    if min(abs(angle) for angle in turned.values()) < _TURNED_RAD:
        return result
    words = ", ".join(f"{math.degrees(a):+.0f} degrees against compass {i}" for i, a in turned.items())
    reason = (
        f"The heading of compass {instance} is turned by {words}: one of them is mounted turned, or its "
        "orientation parameter is wrong."
    )
    return replace(result, accepted=False, reasons=(*result.reasons, reason))


def with_parameters(result: CalibrationResult, track: Track) -> CalibrationResult:
    """Spell a result's correction in the parameters of the recording's autopilot, and remark on others."""
    spelled = values(track.autopilot, track.parameters, result.instance, result.correction)
    remarks = remarks_said(track.autopilot, track.parameters, result.instance)
    return replace(result, parameters=spelled, warnings=(*result.warnings, *remarks))


def _check_compass(track: Track, instance: int) -> None:
    """Refuse a missing or a dead compass."""
    compass = track.compasses.get(instance)
    if compass is None or not len(compass.reported):
        known = ", ".join(str(i) for i in sorted(track.compasses)) or "none"
        raise BadRecording(
            f"{track.source or 'The recording'} has no readings of compass {instance} (it has: {known}).",
            "Choose one of its compasses with --compass.",
        )
    reported = np.asarray(compass.reported.values)
    finite = reported[np.isfinite(reported).all(axis=1)]
    swing = (
        np.percentile(finite, 99, axis=0) - np.percentile(finite, 1, axis=0) if len(finite) else np.zeros(3)
    )
    raw_size = float(np.linalg.norm(np.median(track.raw_field(instance), axis=0))) if len(finite) else 0.0
    if float(swing.max()) < _DEAD_SWING_MGAUSS and raw_size < 20.0:
        raise PoorCalibration(
            f"Compass {instance} reads only its offsets: the sensor itself is silent or not connected.",
            "Check the compass's wiring and power, then record again.",
        )
    if float(swing.max()) < _DEAD_SWING_MGAUSS and _turned(track):
        raise PoorCalibration(
            f"Compass {instance} is frozen: the vehicle turned and its reading did not change.",
            "Check the compass's wiring and driver, then record again.",
        )


def _turned(track: Track) -> bool:
    gyro = track.gyro_radps
    if gyro is None or len(gyro) < 3:
        return False
    rate = np.nan_to_num(np.asarray(gyro.values))
    rate[np.abs(rate) < _BIAS_RADPS] = 0.0
    turned = np.abs(np.cumsum(rate[:-1] * np.diff(gyro.time_s)[:, np.newaxis], axis=0)).max()
    return bool(turned > math.radians(45.0))
