"""What a person learns from a diagnosis: causes, honest doubt, shrink on held-out parts."""

from __future__ import annotations

import json
import math
import re
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mavcompass.cli.main import main
from mavcompass.errors import BadRecording, UsageError
from mavcompass.gap import Diagnosis, diagnose_gap
from mavcompass.gap.export.simulators import ardupilot_sitl
from mavcompass.gap.export.vehicle import Found, affine_map
from mavcompass.gap.trial.cases import Recipe, draw_label, make_track, tracks_of
from mavcompass.logs import write_track_csv
from mavcompass.simulation import effects
from mavcompass.track import Series, Track

RICH = Recipe("rich", duration_s=60.0, rate_hz=10.0, seed=21)


@pytest.fixture(scope="module")
def baseline() -> Track:
    return make_track(replace(RICH, seed=22))


def diagnose(text: str, baseline: Track | None, withhold: tuple[str, ...] = ()) -> Diagnosis:
    settings = [effects.parse(part) for part in text.split("+") if part]
    return diagnose_gap(make_track(RICH, settings), baseline, withhold)


def test_nothing_wrong_is_called_no_gap(baseline: Track) -> None:
    track = make_track(RICH)
    hiding = replace(track, compasses={1: replace(track.compasses[1], less_learnt=True)})
    diagnosis = diagnose_gap(hiding, baseline)
    untold = dict(diagnosis.not_testable)
    assert "estimator" in untold["hard_iron"] and "pile up" in untold["clipping"]
    assert diagnosis.verdict == "no_gap" and not diagnosis.causes and not diagnosis.unknown
    assert diagnosis.field.nominal == pytest.approx(3.0, rel=0.15)


def test_a_diagnosis_does_not_wait_for_a_library(baseline: Track, monkeypatch: pytest.MonkeyPatch) -> None:
    """Loading scipy takes longer than all else that a healthy flight needs."""
    tracks = [make_track(RICH), make_track(RICH, [effects.parse("hard_iron:x=40,y=-25,z=10")])]
    monkeypatch.delitem(sys.modules, "scipy.linalg.lapack", raising=False)
    for name in ("scipy", "scipy.linalg", "scipy.special", "scipy.signal"):
        monkeypatch.setitem(sys.modules, name, None)
    assert [diagnose_gap(t, baseline).verdict for t in tracks] == ["no_gap", "named"]


def test_hard_iron_is_named_with_its_values_and_closes_the_gap(baseline: Track) -> None:
    diagnosis = diagnose("hard_iron:x=40,y=-25,z=10", baseline)
    assert diagnosis.verdict == "named" and diagnosis.effects == {"hard_iron"}
    cause = diagnosis.causes[0]
    for name, true in (("x", 40.0), ("y", -25.0), ("z", 10.0)):
        low, high = cause.ci95[name]
        assert low - 0.3 < true < high + 0.3
    assert diagnosis.field.after < 1.15 * diagnosis.field.floor
    assert diagnosis.field.shrink == pytest.approx(1.0, abs=0.02)
    assert diagnosis.heading.after < 0.3 * diagnosis.heading.nominal
    check_document(json.loads(json.dumps(diagnosis.to_json())))


def check_document(document: dict[str, Any]) -> None:
    """Assert that a document has the promised form."""
    assert document["schema"] == "mavcompass.gap/1"
    assert set(document["gap"]) == {"field_rms_mgauss", "heading_rms_deg"}
    for part in document["gap"].values():
        assert set(part) == {"nominal", "after", "floor", "shrink", "shrink_ci95"}
    cause = document["causes"][0]
    assert cause["effect"] == "hard_iron" and set(cause["ci95"]) == {"x", "y", "z"}
    assert "bias_random_walk" in {entry["effect"] for entry in document["not_testable"]}
    assert all(0.0 <= place["share"] <= 1.0 for place in document["where"])


def test_axis_that_is_saturated_most_of_the_time_leaves_nothing_unexplained() -> None:
    """A vehicle that hardly tilts has its vertical axis at the limit nearly always."""
    fault = [effects.parse("clipping:limit_mgauss=372")]
    recipe = Recipe("figure-8", rate_hz=10.0, seed=23)
    diagnosis = diagnose_gap(make_track(recipe, fault), make_track(replace(recipe, seed=24)))
    assert diagnosis.verdict == "named" and diagnosis.effects == {"clipping"}
    assert diagnosis.causes[0].parameters["limit_mgauss"] == pytest.approx(372.0, abs=0.5)


def test_two_causes_are_both_named_and_share_the_waterfall(baseline: Track) -> None:
    diagnosis = diagnose("motor_current:x=1.5,y=-1+soft_iron:xx=0.04,xy=0.03,zz=-0.03", baseline)
    assert diagnosis.effects == {"motor_current", "soft_iron"}
    total = sum(bar.part_mgauss2 for bar in diagnosis.waterfall)
    assert total == pytest.approx(diagnosis.field.nominal**2 - diagnosis.field.after**2, rel=1e-6)
    for bar in diagnosis.waterfall:
        assert bar.range_mgauss2[0] <= bar.part_mgauss2 <= bar.range_mgauss2[1]


def test_withheld_cause_is_called_unknown_and_named_when_restored(baseline: Track) -> None:
    text = "motor_current:x=1.5,y=-1,z=0.8"
    withheld = diagnose(text, baseline, ("motor_current",))
    assert withheld.verdict in ("unknown", "ambiguous", "named_with_remainder") and withheld.unknown
    assert withheld.field.after <= withheld.field.nominal
    restored = diagnose(text, baseline)
    assert restored.effects == {"motor_current"} and restored.verdict == "named"
    assert restored.field.shrink > 0.97


def test_step_inside_a_held_out_block_is_placed_exactly(baseline: Track) -> None:
    diagnosis = diagnose("hard_iron_step:x=30,y=20,on_s=23.5,off_s=45", baseline)
    assert diagnosis.effects == {"hard_iron_step"}
    assert diagnosis.causes[0].parameters["on_s"] == pytest.approx(23.5, abs=0.15)
    assert diagnosis.field.shrink > 0.97


@pytest.mark.parametrize(
    ("text", "name", "parameter", "true"),
    [
        ("noise_excess:sigma_mgauss=5", "noise_excess", "sigma_mgauss", 5.0),
        ("timestamp_jitter:sigma_s=0.02", "timestamp_jitter", "sigma_s", 0.02),
        ("quantisation:step_mgauss=6", "quantisation", "step_mgauss", 6.0),
        ("stale_samples:fraction=0.2", "stale_samples", "fraction", 0.2),
    ],
)
def test_effects_that_only_scatter_or_repeat_are_named(
    baseline: Track, text: str, name: str, parameter: str, true: float
) -> None:
    diagnosis = diagnose(text, baseline)
    assert diagnosis.effects == {name} and diagnosis.verdict == "named"
    assert diagnosis.causes[0].parameters[parameter] == pytest.approx(true, rel=0.3)


def test_wandering_offset_is_unknown_and_never_a_cause() -> None:
    finer = replace(RICH, rate_hz=20.0)
    wanders = [effects.parse("bias_random_walk:sigma_mgauss_per_sqrt_s=1.5")]
    diagnosis = diagnose_gap(make_track(finer, wanders), make_track(replace(finer, seed=22)))
    assert diagnosis.verdict == "unknown" and diagnosis.unknown and not diagnosis.causes


def test_export_inverts_what_the_firmware_simulates() -> None:
    """ArduPilot's simulator: raw = E^-1 field - OFS."""
    E = np.array([[1.1, 0.03, -0.02], [0.03, 0.9, 0.01], [-0.02, 0.01, 1.02]])
    soft = np.linalg.inv(E) - np.eye(3)
    settings = [
        effects.Setting(
            effects.get("soft_iron"),
            np.array([soft[0, 0], soft[1, 1], soft[2, 2], soft[0, 1], soft[0, 2], soft[1, 2]]),
        ),
        effects.parse("hard_iron:x=-120,y=80,z=-40"),
        effects.parse("low_pass"),
    ]
    exported = ardupilot_sitl(Found(settings))
    names = [f"SIM_MAG1_{kind}_{axis}" for kind in ("OFS", "DIA", "ODI") for axis in "XYZ"]
    expected = [120.0, -80.0, 40.0, 1.1, 0.9, 1.02, 0.03, -0.02, 0.01]
    np.testing.assert_allclose([exported.parameters[n] for n in names], expected, rtol=1e-6)
    assert len(exported.lacking) == 1 and exported.lacking[0].startswith("low_pass")


def test_rotation_is_said_to_be_lacking_in_the_firmware_simulator() -> None:
    exported = ardupilot_sitl(Found([effects.parse("misalignment:z=0.1")]))
    assert "5.73 degrees" in exported.lacking[0]
    matrix, offset = affine_map([effects.parse("misalignment:z=0.1")])
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-12)
    assert not offset.any()


def test_person_is_told_what_is_missing(baseline: Track) -> None:
    with pytest.raises(UsageError, match="to withhold"):
        diagnose("", baseline, ("hard_irn",))
    with pytest.raises(BadRecording, match="no compass 3"):
        diagnose_gap(baseline, instance=3)
    with pytest.raises(BadRecording, match="too few"):
        diagnose_gap(baseline.between(0.0, 1.0))


def test_level_turns_cannot_test_what_needs_tilt_or_loads() -> None:
    recipe = Recipe("yaw-steps", duration_s=60.0, rate_hz=10.0, seed=5)
    diagnosis = diagnose_gap(make_track(recipe), make_track(replace(recipe, seed=6)))
    missing = dict(diagnosis.not_testable)
    assert {"soft_iron", "motor_current", "temperature_bias", "spatial_dipole"} <= set(missing)
    assert "current" in missing["motor_current"]
    assert math.isfinite(diagnosis.seconds)


def test_position_far_from_its_datum_makes_no_gradient() -> None:
    """An altitude above the sea is no distance from a magnet: declination stays declination."""
    track = make_track(RICH, [effects.parse("declination:angle_rad=0.1")])
    assert track.position_ned_m is not None
    far = track.position_ned_m.values + np.array([0.0, 0.0, -500.0])
    moved = replace(track, position_ned_m=Series.of(track.position_ned_m.time_s, far))
    assert diagnose_gap(moved).effects == {"declination"}


@pytest.mark.parametrize("orientation", [4, 8])
def test_orientation_is_found_although_the_yaw_is_unknown(orientation: int) -> None:
    """Without a reference the first guess of the yaw comes from the compass that points elsewhere."""
    fault = [effects.parse(f"orientation:orientation={orientation}")]
    track = make_track(replace(RICH, duration_s=30.0), fault)
    diagnosis = diagnose_gap(replace(track, reference_q=None))
    assert diagnosis.reference == "fused"
    assert diagnosis.effects == {"orientation"}
    assert diagnosis.causes[0].parameters["orientation"] == orientation


def shaken(track: Track, seed: int) -> Track:
    """Let an accelerometer feel motion that is not recorded: it wanders, and follows the throttle."""
    assert track.acc_mps2 is not None and track.throttle is not None
    rng = np.random.default_rng(seed)
    n = len(track.acc_mps2)
    slow = np.cumsum(rng.standard_normal((n, 3)), axis=0)
    slow = 0.15 * (slow - slow.mean(axis=0)) / slow.std(axis=0)
    fast = 0.4 * track.throttle.values[:, None] * rng.standard_normal((n, 3))
    moved = Series.of(track.acc_mps2.time_s, track.acc_mps2.values + slow + fast)
    return replace(track, acc_mps2=moved)


def test_a_gyro_that_counts_for_less_blames_nothing_else_for_its_own_bias(baseline: Track) -> None:
    def seen(track: Track) -> Track:
        assert track.gyro_radps is not None
        turned, values = track.gyro_radps, track.gyro_radps.values
        off = 0.004 + 0.003 * np.sin(3.0 * turned.time_s)[:, None] * np.abs(values)
        return replace(track, gyro_radps=Series.of(turned.time_s, values + off))

    diagnosis = diagnose_gap(seen(make_track(RICH, [effects.parse("hard_iron:x=40")])), seen(baseline))
    assert any("The gyro" in note and "counts for less" in note for note in diagnosis.notes)
    assert diagnosis.effects == {"hard_iron"} and diagnosis.verdict == "named"


def test_accelerometer_that_feels_unknown_motion_still_tells_tilt_from_dip(baseline: Track) -> None:
    """The compass alone cannot tell a platform that is not level from a field that dips elsewhere."""
    fault = [effects.parse("platform_tilt:about_north=0,about_east=0.025")]
    diagnosis = diagnose_gap(shaken(make_track(RICH, fault), 1), shaken(baseline, 2))
    assert any("counts for less" in note for note in diagnosis.notes)
    assert diagnosis.effects == {"platform_tilt"}
    reasons = dict(diagnosis.not_testable)
    assert "accel_bias" in reasons and "motion" in reasons["accel_bias"]


@pytest.mark.parametrize("seed", [5, 7])
def test_iron_that_a_small_turn_shows_in_part_is_blamed_on_nothing_else(seed: int) -> None:
    recipe = Recipe("yaw-steps", duration_s=60.0, rate_hz=10.0, seed=seed)
    track = make_track(recipe, [effects.parse("hard_iron:x=120,y=-60,z=10")]).between(0.0, 8.0)
    diagnosis = diagnose_gap(track)
    assert diagnosis.effects == {"hard_iron"} and "hard_iron" in dict(diagnosis.not_testable)
    assert diagnosis.causes[0].parameters["x"] == pytest.approx(120.0, abs=5.0)


def test_unknown_motion_is_no_fault(baseline: Track) -> None:
    diagnosis = diagnose_gap(shaken(make_track(RICH), 3), shaken(baseline, 4))
    assert diagnosis.verdict == "no_gap"


def test_magnet_that_one_half_of_the_recording_hardly_shows_is_named() -> None:
    label = draw_label(4302, 36, "single")
    assert label.effects[0].startswith("spatial_dipole")
    assert diagnose_gap(*tracks_of(label)).effects == {"spatial_dipole"}


def test_person_diagnoses_and_exports_a_csv(tmp_path: Path, capsys: object) -> None:
    log, good = tmp_path / "log.csv", tmp_path / "good.csv"
    recipe = Recipe("figure-8", duration_s=40.0, rate_hz=10.0, seed=31)
    write_track_csv(make_track(recipe, [effects.parse("hard_iron:x=50,y=-30,z=5")]), log)
    write_track_csv(make_track(replace(recipe, seed=32)), good)
    answer, report, parm = tmp_path / "gap.json", tmp_path / "gap.html", tmp_path / "found.parm"
    arguments = ["gap", "diagnose", str(log), "--baseline", str(good), "--json", str(answer)]
    assert main([*arguments, "--report", str(report)]) == 0
    document = json.loads(answer.read_text())
    assert [c["effect"] for c in document["causes"]] == ["hard_iron"]
    assert len(document["log"]["sha256"]) == 64
    html = report.read_text()
    assert "hard_iron" in html and "<svg" in html and "http" not in html.replace("http-equiv", "")
    shares = [float(share) for share in re.findall(r"<td>(\d+) %</td>", html)]
    assert shares == [round(100.0 * place["share"]) for place in document["where"][:10]]
    export = ["gap", "export", str(log), "--baseline", str(good), "--to", "ardupilot-sitl", str(parm)]
    assert main([*export, "--json", str(answer)]) == 0
    promised = json.loads(answer.read_text())["promised"]
    assert promised["by_what_the_simulator_holds"] == promised["shrink"] > 0.95
    (known,) = [line for line in parm.read_text().splitlines() if line.startswith("# hard_iron, 95 %: x ")]
    low, high = (
        float(word) for word in known.split(", ")[1].removeprefix("95 %: x ").split(" mG")[0].split(" to ")
    )
    assert 49.0 < low < high < 52.0
    values = dict(line.split(",") for line in parm.read_text().splitlines() if not line.startswith("#"))
    assert math.isclose(float(values["SIM_MAG1_OFS_X"]), -50.0, abs_tol=1.0)


def test_catalogue_is_machine_readable(tmp_path: Path) -> None:
    file = tmp_path / "catalogue.json"
    assert main(["gap", "catalogue", "--json", str(file)]) == 0
    listed = {e["id"] for e in json.loads(file.read_text())["effects"]}
    assert listed == set(effects.catalogue())
