"""Accept a calibration or refuse it: the one judgement behind every door.

A method says what its own data show (`reasons`, sigma). Here that is held against all else that was recorded:

1. every source of the heading (`evidence`) is sound or at fault by one rule (`heading.fault_isolation`), and
   the heading's sigma is the rms error over all that may be so: what contradicts widens it, and what widens
   it beyond the limit is the reason;
2. a compass that is turned is calibrated as it is mounted (`mounting`), and the setting that mends it told;
3. the values in force are evidence, too: where the new ones are no better by more than their sigma, level and
   leaning, the compass is right as it is.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mavcompass.calibration.model import gain_parameters
from mavcompass.calibration.mounting import (
    TURNED_RAD,
    as_set,
    likely_rotations,
    mounting_words,
    numbered,
    turned_compass,
)
from mavcompass.calibration.recorded import Recorded
from mavcompass.calibration.result import BEYOND_CHANCE, CalibrationResult, Limits, Mounting, Witness
from mavcompass.calibration.rigid import DEFAULT_PRIOR
from mavcompass.compass_parameters import is_calibrated, orientation_name
from mavcompass.earth_field import EarthField, earth_field_of
from mavcompass.errors import PoorCalibration
from mavcompass.frames import (
    NO_HEADING_RAD,
    NUMBERED_WITHIN_RAD,
    FloatArray,
    angle_between,
    euler_to_matrix,
    wrap_pi,
)
from mavcompass.heading.evidence import (
    FLOOR_RAD,
    CompassHeading,
    Evidence,
    compare,
    compass_heading,
    other_compasses,
)
from mavcompass.heading.fault_isolation import DOUBTED, RATHER_SOUND, FaultIsolation, isolate_faults
from mavcompass.printable import named
from mavcompass.track import Track

# What is left after a numbered orientation is an angle of its own from here on.
_FREE_RAD = math.radians(1.5)
# From one number to the next, about any axis.
_APART_RAD = math.radians(45.0)
_LEAN_RAD = math.radians(15.0)
_PLACELESS = "The place is unknown: nothing is held against the world's magnetic model."

# Calibrates one compass of a recording, by its number, unjudged. Raises PoorCalibration where it cannot be.
Solve = Callable[[Track, int], CalibrationResult]


@dataclass(frozen=True, slots=True)
class Case:
    """Hold what results of one recording are judged by.

    Attributes:
        track: the recording. results: of its compasses by number, unjudged, as far as there are any.
        earth: the Earth's field at the place, None where that is unknown.
        limits: what is accepted.
        solve: calibrates a compass of another recording: of this one, with the compass turned.
        windows: the still stretches (start, end) that count as evidence; None for all of the recording.
    """

    track: Track
    results: Mapping[int, CalibrationResult]
    earth: EarthField | None
    limits: Limits
    solve: Solve
    windows: Sequence[tuple[float, float]] | None = None

    def evidence(self, result: CalibrationResult) -> Evidence:
        """Compare the heading by a result with all else that was recorded.

        Another compass that has no result, or one that is not accepted, counts under the calibration in
        force; so do those that agree since they were given one heading.
        """
        headings = []
        for i in other_compasses(self.track, result.instance):
            other = self.results.get(i)
            mine = other is not None and other.accepted and other.true_heading is None
            headings.append(self._calibrated(other) if mine and other else compass_heading(self.track, i))
        found = compare(self.track, self._calibrated(result), headings, self.earth, self.windows)
        given = "" if result.true_heading is None else result.true_heading.by
        return replace(found, sources=tuple(s for s in found.sources if s.name != given))

    def _calibrated(self, result: CalibrationResult) -> CompassHeading:
        heading = compass_heading(self.track, result.instance, result.correction)
        sigma = math.hypot(math.radians(result.repeatable_sigma_deg), FLOOR_RAD)
        return replace(heading, sigma_rad=sigma, calibrated=True, by_itself=_by_itself(result))


def _by_itself(result: CalibrationResult) -> dict[str, float]:
    """Return how far a calibration's gains are from those of compasses, in sigmas.

    What is mounted turned sees other parts of the field; fitted as it is set, its gains are no compass's.
    """
    prior = DEFAULT_PRIOR
    vertical = math.hypot(prior.gain_sigma, prior.vertical_gain_sigma)
    sigma = np.array([prior.gain_sigma, prior.gain_sigma, vertical, *3 * [prior.cross_sigma]])
    if result.heading_error is not None:
        sigma = np.hypot(sigma, np.sqrt(np.diag(result.heading_error.covariance)[3:9]))
    away = gain_parameters(result.correction.inverse) - prior.gains
    return {"gains": float(np.abs(away / sigma).max())}


def judge(case: Case, result: CalibrationResult) -> CalibrationResult:
    """Return a result as it may be claimed: accepted, already right, or refused with its reasons."""
    evidence = case.evidence(result)
    found = isolate_faults(evidence.sources)
    judged = _told(case, _weighed(result, evidence, found, case.limits), found)
    if judged.accepted:
        return _right_already(judged, case.track)
    as_mounted = _as_mounted(case, result, found)
    if as_mounted is None:
        return judged
    # What else seems wrong with a compass that is turned only follows from that.
    mounting, reasons = as_mounted
    told_by = [found.sources[i].name for i in found.likeliest if i > 0]
    return replace(judged, mounting=mounting, reasons=(mounting_words(judged, mounting, told_by), *reasons))


def _weighed(
    result: CalibrationResult, evidence: Evidence, found: FaultIsolation, limits: Limits
) -> CalibrationResult:
    """Claim no less than the rms error by all that the sources may show, and judge by that."""
    beyond_rad = math.hypot(found.beyond_rad(0), evidence.scatter_rad)
    sigma_deg = math.hypot(result.heading_sigma_deg, math.degrees(beyond_rad))
    why = _contradiction(found, evidence)
    if why and result.true_heading is not None:
        why += " Or the heading that was given is not the vehicle's."
    return replace(result, north=evidence.north).widened(sigma_deg, "disagreement").within(limits, why)


def _contradiction(found: FaultIsolation, evidence: Evidence) -> str:
    """Say which evidence speaks most against the first source; "" where there is none."""
    mine, others = found.sources[0], [s for s in found.sources[1:] if not math.isnan(s.deviation_rad[0])]
    if not others:
        rest = [s.name for s in found.sources[1:]]
        return f"{mine.name.capitalize()} does not turn with {named(rest)}." if rest else ""
    if 0 in found.blamed:
        return found.why(0)
    if max(evidence.scatter_rad, found.beyond_rad(0)) < mine.sigma_rad:
        return ""
    if evidence.scatter_rad > found.beyond_rad(0):
        return (
            f"{mine.name.capitalize()} moves by {math.degrees(evidence.scatter_rad):.1f} deg against"
            f" {named([s.name for s in others])}: something magnetic changes near it, or it is read late."
        )
    far = max(others, key=lambda s: abs(float(wrap_pi(s.deviation_rad[0]))))
    apart = math.degrees(abs(float(wrap_pi(far.deviation_rad[0]))))
    stands = f"{far.name.capitalize()} stands {apart:.0f} deg from {mine.name}"
    if apart < math.degrees(TURNED_RAD):
        return f"{stands}, and nothing tells which is wrong."
    return f"{stands}: one of them is mounted turned, or set so, and nothing tells which."


def _told(case: Case, result: CalibrationResult, found: FaultIsolation) -> CalibrationResult:
    """Put the evidence into the result, and say where there was none."""
    track = case.track
    if case.earth is None and earth_field_of(track) is None:
        result = replace(result, warnings=(*result.warnings, _PLACELESS))
    mine, witnesses = found.sources[0], []
    for source in found.sources[1:]:
        difference = float(wrap_pi(source.deviation_rad[0]))
        if math.isnan(difference):
            continue
        sigma = math.hypot(source.sigma_rad, mine.sigma_rad)
        contradicts = abs(difference) > BEYOND_CHANCE * sigma
        witnesses.append(Witness(source.name, math.degrees(difference), math.degrees(sigma), contradicts))
    result = replace(result, evidence=(*result.evidence, *witnesses))
    if witnesses and result.true_heading is None:
        return replace(result, mounting=Mounting(seen=True))
    motion = "by turning alone" if result.true_heading is None else "at one heading"
    setting = orientation_name(track.autopilot, track.parameters, result.instance)
    unseen = (
        f"Which way the compass is mounted cannot be seen {motion}, and nothing else that was recorded"
        f" tells it: taken {f'from {setting}' if setting else 'as recorded'}."
    )
    return replace(result, warnings=(*result.warnings, unseen))


# --- right already ------------------------------------------------------------------------------------


def _right_already(result: CalibrationResult, track: Track) -> CalibrationResult:
    """Mark a compass whose values in force are no worse than the new ones beyond their sigma.

    What the autopilot takes for no calibration is written, however right it may be.
    """
    known = is_calibrated(track.autopilot, track.parameters, result.instance, result.in_force)
    if not known or not math.isfinite(result.heading_change_deg) or result.mounting.turned is not None:
        return result
    leaning = [(0.0, 0.0)]
    if result.heading_error is not None:
        leaning += [(_LEAN_RAD, 0.0), (-_LEAN_RAD, 0.0), (0.0, _LEAN_RAD), (0.0, -_LEAN_RAD)]
    for roll, pitch in leaning:
        change = result.change_rad(roll, pitch)
        sigma = math.radians(result.heading_sigma_deg)
        if (roll or pitch) and result.heading_error is not None:
            sigma = max(sigma, result.heading_error.rms_rad(roll, pitch))
        if math.sqrt(float((change**2).mean())) > BEYOND_CHANCE * sigma:
            return result
    if result.true_heading is not None and result.heading_error is not None:
        # One heading is known far better than the circle: there the values in force must be right, too.
        circle = np.arange(72) * (2.0 * math.pi / 72)
        sigma_rad = np.tile(result.heading_error.sigma_rad(circle), len(result.loads))
        if (np.abs(result.change_rad()) > BEYOND_CHANCE * sigma_rad).any():
            return result
    return replace(result, already_right=True)


# --- the mounting -------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class _Trial:
    """Hold a compass calibrated as if it were mounted turned by a rotation (3, 3), and how likely that is."""

    rotation: FloatArray
    log_evidence: float
    solved: CalibrationResult
    evidence: Evidence
    found: FaultIsolation


def _as_mounted(
    case: Case, result: CalibrationResult, found: FaultIsolation
) -> tuple[Mounting, tuple[str, ...]] | None:
    """Find the likeliest mounting of a refused compass by all the evidence; None where that leaves it open.

    With it come the reasons, if any, not to accept the compass so mounted either.
    """
    believed = [found.sources[i] for i in found.likeliest if i > 0 and found.sound[i] > RATHER_SOUND]
    if not believed:
        return None
    recorded = Recorded(case.track, result.instance, case.earth, case.limits, windows=case.windows)
    # No other source can say more for a rotation than against another, at fault there and sound here.
    reach = sum(_log_room(2.0 * math.pi, source.sigma_rad) - math.log(source.fault) for source in believed)
    try:
        likely = likely_rotations(recorded, reach)
    except PoorCalibration:
        return None
    trials = [trial for one in likely if (trial := _tried(case, result, *one)) is not None]
    if not trials:
        return None
    best = max(trials, key=lambda trial: trial.log_evidence)
    alike = [angle_between(trial.rotation, best.rotation) < TURNED_RAD for trial in trials]
    share = np.exp([trial.log_evidence - best.log_evidence for trial in trials])
    least_rad = BEYOND_CHANCE * math.radians(best.solved.heading_sigma_deg)
    if 0 not in found.blamed:  # nothing but its own readings speak for a rotation
        least_rad = max(TURNED_RAD, least_rad)
    if (
        np.linalg.det(best.rotation) < 0.0
        or share[alike].sum() < DOUBTED * share.sum()
        or best.found.sound[0] < RATHER_SOUND
        or angle_between(best.rotation, np.eye(3)) < least_rad
    ):
        return None
    judged = _weighed(best.solved, best.evidence, best.found, case.limits)
    return as_set(case.track, _told(case, judged, best.found), best.rotation), judged.reasons


def _tried(case: Case, result: CalibrationResult, rotation: FloatArray, log_evidence: float) -> _Trial | None:
    """Calibrate a compass as if it were turned by a rotation, and turn it further as the others tell."""
    track, instance = case.track, result.instance
    before_rad = math.inf
    while True:
        turned = replace(case, track=turned_compass(track, instance, rotation))
        try:
            solved = case.solve(turned.track, instance)
        except PoorCalibration:
            return None
        mounting = Mounting(seen=True, turned=rotation)
        solved = replace(solved, in_force=result.in_force.turned(rotation), mounting=mounting).compared()
        evidence = turned.evidence(solved)
        found = isolate_faults(evidence.sources)
        others_rad = min(found.others_sigma_rad(0), NO_HEADING_RAD)
        free = numbered(track, instance, rotation, NUMBERED_WITHIN_RAD) is rotation
        # A number is as likely as all angles on the way to the next: so far off, one of these is likelier.
        own_rad = max(_FREE_RAD, others_rad * math.sqrt(2.0 * _log_room(_APART_RAD, others_rad)))
        # Readings that are turned clockwise show a heading that much less.
        away = found.apart_rad(0)
        # What no longer shrinks is what two headings differ by however the compass is turned.
        if abs(away) < (others_rad if free else own_rad) or not abs(away) <= 0.5 * before_rad:
            break
        before_rad = abs(away)
        rotation = numbered(track, instance, euler_to_matrix(0.0, 0.0, away) @ rotation, own_rad)
    # A free angle is known as well as the others' headings, a number as well as these bear it out.
    unsure_deg = math.degrees(max(others_rad, abs(away)) if free else abs(away))
    solved = solved.widened(math.hypot(solved.heading_sigma_deg, unsure_deg), "mounting")
    log_evidence += found.log_evidence
    if free:
        log_evidence -= _log_room(_APART_RAD, others_rad) + 2.0 * _log_room(_APART_RAD, NUMBERED_WITHIN_RAD)
    return _Trial(rotation, log_evidence, solved, evidence, found)


def _log_room(room_rad: float, sigma_rad: float) -> float:
    """Return the log of how many angles are told apart within so much room; 0 where none is."""
    return max(math.log(room_rad / (math.sqrt(2.0 * math.pi) * sigma_rad)), 0.0)
