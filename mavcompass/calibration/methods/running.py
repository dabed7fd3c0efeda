"""A running calibration of a recording: in constant memory, as a service learns from ordinary driving."""

from __future__ import annotations

import math

import numpy as np

from mavcompass.calibration.comparison import at_least, compared, judged
from mavcompass.calibration.methods.world_field import COVARIANCE_NAMES, correction_of
from mavcompass.calibration.model import HORIZONTAL, VERTICAL
from mavcompass.calibration.motion.findings import gain_words
from mavcompass.calibration.motion.fit import sigma_of
from mavcompass.calibration.motion.honesty import weigh_honestly
from mavcompass.calibration.motion.observed import observe_motion
from mavcompass.calibration.motion.running import RunningFit, begin, begin_at, update
from mavcompass.calibration.recorded import Recorded
from mavcompass.calibration.result import CalibrationResult
from mavcompass.errors import PoorCalibration

_MOST_NOT_SEEN = 5


def calibrate(recorded: Recorded) -> CalibrationResult:
    """Run through a recording section by section; the result is what is known at its end.

    Raises PoorCalibration where the recording has no gyro, or never goes far enough round to begin.
    """
    motion = observe_motion(recorded)
    sections = motion.sections
    count = begin_at(sections)
    if count is None:
        raise PoorCalibration(
            "The vehicle never turned far enough for a running calibration to begin.",
            "Drive or fly through all headings.",
        )
    first = motion.first(count)
    honest = weigh_honestly(first.sections, first.fit, recorded.prior)
    claimed = honest.error.rms_rad() / sigma_of(first.fit)
    running = begin(first.sections, first.fit, max(claimed, 1.0) ** 2)
    for k in range(count, len(sections)):
        running = update(running, sections.rows(k, k + 1), float(sections.step_sigma_rad[k - 1]))
    correction = correction_of(motion, running.state)
    sigma = math.degrees(running.heading_error.rms_rad())
    result = CalibrationResult(
        instance=recorded.instance,
        method="running",
        accepted=False,
        reasons=_reasons(running),
        warnings=_warnings(running, recorded),
        raw_offset_mgauss=-np.asarray(correction.offsets_mgauss),
        correction=correction,
        in_force=recorded.in_force,
        covariance_names=COVARIANCE_NAMES,
        covariance=running.heading_error.covariance,
        not_observable=("mounting_yaw",),
        residual_rms_mgauss=running.model_mgauss,
        heading_sigma_deg=sigma,
        heading_budget_deg={"noise": sigma},
        heading_error=running.heading_error,
        horizontal_mgauss=float(running.state[HORIZONTAL]),
        vertical_mgauss=float(running.state[VERTICAL]),
    )
    left = motion.scatter_left_rad(correction) if math.isnan(running.changed_s) else 0.0
    return at_least(judged(compared(result), recorded.limits), left, recorded.limits)


def _reasons(running: RunningFit) -> tuple[str, ...]:
    if len(running.not_seen_deg) <= _MOST_NOT_SEEN:
        return ()
    return (f"{_headings(running)} were not seen yet. Drive or fly through them.",)


def _warnings(running: RunningFit, recorded: Recorded) -> tuple[str, ...]:
    said = []
    if running.not_seen_deg:
        said.append(f"Not seen yet: {_headings(running)}.")
    if not math.isnan(running.changed_s):
        said.append(f"The iron changed at {running.changed_s:.0f} s; what was learnt before it is forgotten.")
    if recorded.earth is not None and (words := gain_words(running.state[3:6])):
        said.append(words)
    return tuple(said)


def _headings(running: RunningFit) -> str:
    return "headings " + ", ".join(f"{deg} to {deg + 30}" for deg in running.not_seen_deg) + " degrees"
