"""What the calibration in force cures is known, part of the nominal simulation, and exported."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mavcompass.correction import FieldCorrection
from mavcompass.gap import diagnose_gap
from mavcompass.gap.export.simulators import ardupilot_sitl
from mavcompass.gap.export.vehicle import Found, vehicle_settings
from mavcompass.gap.trial.cases import Recipe, make_track
from mavcompass.report.gap_words import summary
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


def test_iron_that_the_calibration_cures_is_no_cause() -> None:
    diagnosis = diagnose_gap(with_calibration(made(), FieldCorrection(offsets_mgauss=(30.0, -20.0, -12.0))))
    assert diagnosis.verdict == "no_gap" and not diagnosis.causes
    assert diagnosis.in_force is not None and diagnosis.corrected_rms_mgauss is not None
    np.testing.assert_allclose(diagnosis.in_force.cures.offset_mgauss, [-30.0, 20.0, 12.0])
    assert diagnosis.corrected_rms_mgauss < 5.0
    document = diagnosis.to_json()
    assert document["in_force"]["cures"]["hard_iron"] == [-30.0, 20.0, 12.0]  # type: ignore[index]
    assert "the calibration in force cures: hard iron (-30, 20, 12) mG" in "\n".join(summary(diagnosis, True))


@pytest.mark.parametrize("offsets", [(15.0, -10.0, -6.0), (60.0, -40.0, -24.0)])
def test_hard_iron_is_what_the_calibration_does_not_know(offsets: tuple[float, float, float]) -> None:
    diagnosis = diagnose_gap(with_calibration(made(), FieldCorrection(offsets_mgauss=offsets)))
    assert diagnosis.effects == {"hard_iron"}
    (cause,) = diagnosis.causes
    for axis, true, known in zip("xyz", (-30.0, 20.0, 12.0), offsets, strict=True):
        assert cause.parameters[axis] == pytest.approx(true + known, abs=2.5)
    # A simulator gets the whole of it.
    whole = ardupilot_sitl(Found(vehicle_settings(diagnosis))).parameters
    assert whole["SIM_MAG1_OFS_X"] == pytest.approx(30.0, abs=2.0)


def test_what_a_baseline_teaches_goes_to_the_simulator_too() -> None:
    """A calibration that was never right: baseline and flight share its iron, the flight has more."""
    wrong = FieldCorrection(offsets_mgauss=(60.0, -40.0, -24.0))
    recipe = Recipe("figure-8", duration_s=60.0, seed=52)
    baseline = with_calibration(make_track(recipe, [_HARD_IRON]), wrong)
    more = effects.parse("hard_iron:x=0,y=50,z=0")
    diagnosis = diagnose_gap(with_calibration(make_track(recipe, [_HARD_IRON, more], 1), wrong), baseline)
    assert diagnosis.effects == {"hard_iron"}
    assert diagnosis.causes[0].parameters["y"] == pytest.approx(50.0, abs=2.0)
    whole = ardupilot_sitl(Found(vehicle_settings(diagnosis))).parameters
    assert whole["SIM_MAG1_OFS_X"] == pytest.approx(30.0, abs=2.0)
    assert whole["SIM_MAG1_OFS_Y"] == pytest.approx(-70.0, abs=2.0)


def test_without_a_calibration_nothing_is_said_of_it() -> None:
    diagnosis = diagnose_gap(made())
    assert diagnosis.corrected_rms_mgauss is None and diagnosis.effects == {"hard_iron"}
    assert "calibration" not in "\n".join(summary(diagnosis, True))
