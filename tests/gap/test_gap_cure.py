"""What the calibration in force already cures is said beside what was found in the raw sensor."""

from __future__ import annotations

from dataclasses import replace

import pytest

from mavcompass.cli.gap import summary
from mavcompass.correction import FieldCorrection
from mavcompass.gap import diagnose_gap
from mavcompass.gap.cases import Recipe, make_track
from mavcompass.simulation import effects
from mavcompass.track import InForce, MagSeries, Series, Track

_HARD_IRON = effects.parse("hard_iron:x=-30,y=20,z=12")


def with_calibration(track: Track, correction: FieldCorrection) -> Track:
    """Report what an autopilot with a calibration would."""
    compass = track.compasses[1]
    reported = Series.of(compass.time_s, correction.apply(compass.reported.values))
    return replace(track, compasses={1: MagSeries(1, reported, (InForce(-1.0, correction),))})


def made() -> Track:
    return make_track(Recipe("figure-8", duration_s=40.0, seed=51), [_HARD_IRON])


@pytest.mark.parametrize(
    ("offsets", "lowest", "highest", "sentence"),
    [
        ((30.0, -20.0, -12.0), 0.95, 1.0, "The calibration in force cures it"),
        ((15.0, -10.0, -6.0), 0.45, 0.55, " % of it"),
        ((60.0, -40.0, -24.0), 0.0, 0.05, "does not cure it"),
    ],
)
def test_share_that_a_calibration_cures_is_said(
    offsets: tuple[float, float, float], lowest: float, highest: float, sentence: str
) -> None:
    diagnosis = diagnose_gap(with_calibration(made(), FieldCorrection(offsets_mgauss=offsets)))
    assert diagnosis.effects == {"hard_iron"}
    (cause,) = diagnosis.causes
    assert cause.parameters["x"] == pytest.approx(-30.0, abs=1.5)
    assert cause.cured is not None and lowest <= cause.cured <= highest
    assert diagnosis.corrected_rms_mgauss is not None
    left = (1.0 - cause.cured) * diagnosis.field.nominal
    assert diagnosis.corrected_rms_mgauss == pytest.approx(
        (left**2 + diagnosis.field.after**2) ** 0.5, rel=0.1
    )
    assert diagnosis.to_json()["causes"][0]["cured_by_calibration"] == cause.cured  # type: ignore[index]
    assert sentence in "\n".join(summary(diagnosis))


def test_without_a_calibration_nothing_is_said_of_it() -> None:
    diagnosis = diagnose_gap(made())
    assert diagnosis.corrected_rms_mgauss is None and diagnosis.causes[0].cured is None
    assert "calibration" not in "\n".join(summary(diagnosis))
