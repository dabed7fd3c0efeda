"""What is made of the motion of made-up recordings, number by number, as it was when it was stored."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from made_up_recordings import (
    EARTH,
    IN_FORCE,
    IRON,
    four_stops,
    hovering,
    tumbling,
    wandering,
    with_late_gyro,
    with_magnet,
    with_reference,
)

from mavcompass.calibration.findings import findings
from mavcompass.calibration.motion.fit import (
    ModelError,
    begin,
    leaning_error,
    level_headings,
    section_variance,
    sigma_of,
)
from mavcompass.calibration.motion.honesty import scatter_left_rad, weigh_honestly
from mavcompass.calibration.motion.left_out import last_stretch, without_disturbed_stop
from mavcompass.calibration.motion.observed import Motion, observe_motion
from mavcompass.calibration.recorded import Recorded
from mavcompass.calibration.result import Limits

AsStored = Callable[[Any], None]
MADE: dict[str, Callable[[], Recorded]] = {
    "four stops": lambda: Recorded(four_stops(), earth=EARTH),
    "four stops, somewhere": lambda: Recorded(four_stops("boat", -1.0, 21)),
    "one stop beside steel": lambda: Recorded(with_magnet(four_stops(), 11.0, 18.0), earth=EARTH),
    "wandering": lambda: Recorded(wandering(), earth=EARTH),
    "iron that moved": lambda: Recorded(with_magnet(wandering(), 0.0, 38.0), earth=EARTH),
    "something passed": lambda: Recorded(with_magnet(wandering("boat", 22), 40.0, 44.0), earth=EARTH),
    "no current": lambda: Recorded(replace(wandering(), current_a=None), earth=EARTH),
    "with a reference": lambda: Recorded(with_reference(wandering()), earth=EARTH),
    "a gyro that is late": lambda: Recorded(with_late_gyro(four_stops(seed=23)), earth=EARTH),
    "hovering": lambda: Recorded(hovering(), earth=EARTH),
    "tumbling": lambda: Recorded(tumbling()),
}


@pytest.fixture(scope="module", params=MADE)
def motion(request: pytest.FixtureRequest) -> Motion:
    return observe_motion(MADE[request.param]())


def test_sections(motion: Motion, as_stored: AsStored) -> None:
    s = motion.sections
    spans = ("start_s", "end_s", "samples", "load", "repeats")
    names = (*spans, "tilt_sigma_rad", "step_sigma_rad", "turned_rad")
    as_stored(
        {
            **{name: getattr(s, name)[::2] for name in names},
            "mean": s.mean_mgauss[::4],
            "mapping": s.mapping[::8],
            "by lag": s.by_lag[::16],
            "hidden": s.hidden_mgauss[::8],
            "one": [s.noise_mgauss, s.tilt_bias_rad, s.bias_sigma_radps, s.scale_sigma, s.load_mean],
            "rate": s.gyro_rate_hz,
            "source": motion.load_source,
        }
    )


def test_fit(motion: Motion, as_stored: AsStored) -> None:
    fit = motion.fit
    as_stored(
        {
            "state": fit.state[:20],
            "sigma": np.sqrt(np.diag(fit.covariance))[:20],
            "sound": fit.sound,
            "one": [fit.error.mgauss, fit.cost, fit.horizontal_mgauss, sigma_of(fit)],
            "residual": fit.residual_mgauss[::5],
            "leaning": leaning_error(motion.sections, fit)[:11],
            "level": level_headings(motion.sections, fit, 1.5)[::6],
        }
    )


def test_where_the_fit_begins(motion: Motion, as_stored: AsStored) -> None:
    s = motion.sections
    first, rules, _ = begin(motion.recorded, s, motion.load_source)
    fit = motion.fit
    as_stored(
        {
            "first": first[:20],
            "prior": [np.diag(rules.rows.T @ rules.rows)[:17], rules.wanted, rules.of(fit.state)],
            "variance": section_variance(s, fit.state, ModelError(2.0))[::6],
            "unweighed": section_variance(s, fit.state, ModelError(2.0), weighed=False)[::9],
        }
    )


def test_what_it_may_claim(motion: Motion, as_stored: AsStored) -> None:
    honest = weigh_honestly(motion.sections, motion.fit)
    limited = [replace(motion.recorded, limits=Limits(limit)) for limit in (0.3, 2.0)]
    told = [findings(replace(motion, motors_told=False, recorded=one), honest) for one in limited]
    later, change = last_stretch(motion)
    disturbed = without_disturbed_stop(motion)
    as_stored(
        {
            "error": honest.error.rms_rad(),
            "one": [honest.noise_rad, honest.accelerometer_rad, honest.scatter_rad],
            "told": told,
            "halves": motion.halves_ratio(),
            "left": [scatter_left_rad(motion, correction) for correction in (IN_FORCE, IRON)],
            "change": change,
            "later": later.fit.state[:9],
            "stop": None if disturbed is None else disturbed.motion.fit.state[:9],
        }
    )
