"""Calibrate a compass from a recording, by any of the methods."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import TypeVar

import numpy as np

from mavcompass.blas import single_thread
from mavcompass.calibration.judge import Case, judge
from mavcompass.calibration.methods import find_method
from mavcompass.calibration.recorded import Recorded
from mavcompass.calibration.result import DEFAULT_LIMITS, CalibrationResult, Limits, OwnFinding, TrueHeading
from mavcompass.compass_parameters import values
from mavcompass.credible import SILENT, is_silent
from mavcompass.earth_field import EarthField, earth_field_of
from mavcompass.errors import MavCompassError, PoorCalibration
from mavcompass.gravity import require_gravity
from mavcompass.heading.doubt import turned_since_new, turned_vector
from mavcompass.parameter_remarks import remarks_said
from mavcompass.track import Series, Track

_DEAD_SWING_MGAUSS = 3.0
_TURNED_RAD = math.radians(45.0)
_T = TypeVar("_T")
NOTHING_FOUND: Mapping[int, OwnFinding] = MappingProxyType({})


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
    turn: bool = False,
    true_heading: TrueHeading | None = None,
) -> CalibrationResult:
    """Calibrate one compass of a recording; see `calibrate_compasses`.

    Raises BadRecording where the compass is missing, PoorCalibration where the recording cannot give a
    calibration at all (too little motion, a dead compass), UsageError for an unknown method. A result
    that is not worth writing comes back with `accepted` False and its reasons.
    """
    found = calibrate_compasses(
        track,
        method,
        (instance,),
        limits=limits,
        earth=earth,
        use_world_model=use_world_model,
        windows=windows,
        turn=turn,
        true_heading=true_heading,
    )
    return found[instance]


@single_thread()
def calibrate_compasses(
    track: Track,
    method: str = "auto",
    instances: tuple[int, ...] | None = None,
    *,
    limits: Limits = DEFAULT_LIMITS,
    earth: EarthField | None = None,
    use_world_model: bool = True,
    windows: Sequence[tuple[float, float]] | None = None,
    turn: bool = False,
    true_heading: TrueHeading | None = None,
    found: Mapping[int, OwnFinding] = NOTHING_FOUND,
) -> dict[int, CalibrationResult]:
    """Calibrate compasses of one recording (None: all), each judged by all that was recorded beside it.

    Args:
        track: the recording.
        method: one of `methods.method_names()`.
        instances: the compasses, counting from 1; the others are calibrated as witnesses.
        limits: what is accepted.
        earth: the Earth's field; None takes it from the recording's place and date.
        use_world_model: False leaves scale and Z alone even where the place is known.
        windows: the still stretches (start, end) for four-positions and one-point; None finds them.
        turn: True takes a compass that is mounted turned as it is mounted: its result then sets the
            orientation, too.
        true_heading: for one-point; None takes a second antenna's.
        found: for autopilot; what its own calibration found, by compass.

    One without a solution is refused with its reason. Raises what `calibrate_track` raises, PoorCalibration
    only where no compass that is asked for has a solution.
    """
    solve = find_method(method)
    chosen = tuple(sorted(track.compasses)) if instances is None else instances
    world = (earth or earth_field_of(track)) if use_world_model else None

    def solved(of: Track, instance: int) -> CalibrationResult:
        given = Recorded(of, instance, world, limits, windows=windows, true_heading=true_heading)
        return solve(replace(given, found=found.get(instance)))

    track, ended = _within_range(track)
    results, refusals = _each(track, {*chosen, *track.compasses}, solved)
    unsolved = [refusals[i] for i in chosen if i in refusals]
    wrong = [refusal for refusal in unsolved if not isinstance(refusal, PoorCalibration)]
    if wrong or (chosen and len(unsolved) == len(chosen)):
        raise (wrong or unsolved)[0]
    case = Case(track, results, world, limits, solved, windows)
    judged: dict[int, CalibrationResult] = {}
    for i in chosen:
        if i in refusals:
            judged[i] = refused(track, method, i, refusals[i])
            continue
        result = judge(case, results[i])
        if turn and result.mounting.mended is not None:
            judged[i] = result.mounting.mended
            continue
        if i in ended:
            result = replace(result, warnings=(ended[i], *result.warnings))
        judged[i] = with_parameters(result, track)
    return judged


def _each(
    track: Track, instances: Collection[int], solve: Callable[[Track, int], _T]
) -> tuple[dict[int, _T], dict[int, MavCompassError]]:
    """Solve for each compass by itself; beside the solutions stands why there is none."""
    solved: dict[int, _T] = {}
    refusals: dict[int, MavCompassError] = {}
    for i in sorted(instances):
        try:
            _check_compass(track, i)
            solved[i] = solve(track, i)
        except MavCompassError as refusal:
            refusals[i] = refusal
    return solved, refusals


def _within_range(track: Track) -> tuple[Track, dict[int, str]]:
    """Leave out readings at the end of what a sensor can show, and say so of the compasses that have any."""
    within, said = dict(track.compasses), {}
    for i, compass in track.compasses.items():
        at_end = track.saturated(i)
        if at_end.any():
            reported = Series(compass.time_s[~at_end], compass.reported.values[~at_end])
            within[i] = replace(compass, reported=reported)
            said[i] = (
                f"{100.0 * at_end.mean():.0f} % of the readings of compass {i} stand at the end of what its "
                "sensor can show: they were left out. Move it away from strong iron and power leads, or set "
                "a wider range."
            )
    return replace(track, compasses=within), said


def refused(track: Track, method: str, instance: int, refusal: MavCompassError) -> CalibrationResult:
    """Keep what is in force for a compass that the recording cannot calibrate."""
    in_force = Recorded(track, instance).in_force
    return CalibrationResult(
        instance=instance,
        method=method,
        accepted=False,
        reasons=(str(refusal),),
        correction=in_force,
        in_force=in_force,
    )


def with_parameters(result: CalibrationResult, track: Track) -> CalibrationResult:
    """Spell a result's correction in the parameters of the recording's autopilot, and remark on others."""
    spelled = values(track.autopilot, track.parameters, result.instance, result.correction)
    remarks = remarks_said(track.autopilot, track.parameters, result.instance)
    return replace(result, parameters=spelled, warnings=(*result.warnings, *remarks))


def _check_compass(track: Track, instance: int) -> None:
    """Refuse a missing or a dead compass, and an accelerometer that is dead."""
    compass = track.compass(instance)
    require_gravity(track.acc_mps2, PoorCalibration)
    reported = np.asarray(compass.reported.values)
    finite = reported[np.isfinite(reported).all(axis=1)]
    swing = np.ptp(np.percentile(finite, [1, 99], axis=0), axis=0) if len(finite) else np.zeros(3)
    dead = float(swing.max()) < _DEAD_SWING_MGAUSS
    if dead and (not len(finite) or is_silent(track.raw_field(instance))):
        remedy = "Check the compass's wiring and power, then record again."
        raise PoorCalibration(SILENT.format(instance), remedy)
    if dead:  # noise alone is nothing new
        followed = np.linalg.norm(turned_vector(track, compass.time_s), axis=1)
    else:
        followed = turned_since_new(track, instance)
    frozen = np.flatnonzero(followed > _TURNED_RAD)
    if frozen.size:
        at = math.floor(float(compass.time_s[frozen[0]] - compass.time_s[0]))
        raise PoorCalibration(
            f"No heading can be determined: compass {instance} is frozen. {at} s after its first reading the"
            " vehicle had turned by 45 degrees and the reading had not changed.",
            "Check the compass's wiring and driver, then record again.",
        )
