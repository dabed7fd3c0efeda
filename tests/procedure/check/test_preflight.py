"""The pre-flight check as a person at the field sees it."""

from __future__ import annotations

import json
import math
import subprocess
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from mavcompass import messages as mav
from mavcompass.cli.check import command
from mavcompass.correction import FieldCorrection
from mavcompass.enums import MavVtolState
from mavcompass.errors import Refused
from mavcompass.procedure.check import CheckReport, CheckSettings, check
from mavcompass.procedure.script import Machine, Show
from mavcompass.simulation.physics.hand import HandMove
from mavcompass.simulation.physics.profiles import VehicleProfile
from mavcompass.simulation.physics.sensors import CompassModel, CompassSetup
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.vehicle.dialects import make_dialect
from mavcompass.vehicle.driver import run
from mavcompass.vehicle.links.simulated import SimulatedLink


def checked(
    vehicle: SimulatedAutopilot, turn: str = "auto", show: Callable[[Show], None] | None = None
) -> CheckReport:
    settings = CheckSettings(turn=turn)  # type: ignore[arg-type]
    machine = Machine(lambda context: check(context, make_dialect, settings))
    return run(machine, SimulatedLink(vehicle), on_show=show)


def verdicts(report: CheckReport, name: str, instance: int = 1) -> list[str]:
    return [item.verdict for item in report.items if item.name == name and item.instance in (0, instance)]


def test_a_well_calibrated_vehicle_passes_with_a_turn() -> None:
    shown: list[Show] = []
    report = checked(SimulatedAutopilot("rover", seed=2, calibration="exact"), show=shown.append)
    assert report.turned
    told = [(one.fraction, one.step) for one in shown if one.fraction is not None]
    assert [step for _, step in told] == ["connect", "dwell", "turn", "dwell"]
    assert all(0.0 <= before < after < 1.0 for (before, _), (after, _) in pairwise(told))
    assert report.verdict == "pass", [i for i in report.items if i.verdict != "pass"]
    assert verdicts(report, "gyro") == ["pass"] and not report.calibration_advised
    assert report.summary().startswith("Fit to ")
    assert [i.instance for i in report.items if i.name == "yaw"] == [1], "of the compass that steers it"


def test_a_badly_calibrated_vehicle_fails_and_the_turn_shows_it() -> None:
    report = checked(SimulatedAutopilot("rover", seed=3))
    assert report.verdict == "fail"
    assert verdicts(report, "turn") == ["fail"]
    assert report.calibration_advised


@pytest.mark.parametrize(
    ("kind", "turn", "armed", "mode", "says"),
    [
        ("rover", "auto", False, None, None),
        ("rover", "vehicle", False, None, "it is disarmed."),
        ("rover", "hand", True, None, "it is armed, and turning it by hand is not safe."),
        ("quadplane", "vehicle", True, "FW", "this ardupilot plane cannot turn on the spot."),
        ("quadplane", "auto", True, "FW", None),
        ("rover", "auto", True, "MANUAL", None),  # it refuses, and nobody asked for it
    ],
)
def test_where_nobody_turns_it_that_is_told_to_who_asked(
    kind: str, turn: str, armed: bool, mode: str | None, says: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    vehicle = SimulatedAutopilot(kind, seed=2, calibration="exact")
    if mode == "FW":
        monkeypatch.setattr(VehicleProfile, "vtol_state", MavVtolState.FW)
    elif mode is not None:
        vehicle.pilot_switches_mode(mode)
    if not armed:
        vehicle.disarm()
    report = checked(vehicle, turn)
    assert not report.turned
    told = [(i.verdict, i.text) for i in report.items if i.name == "turn"]
    assert told == ([] if says is None else [("warn", f"No turn was made: {says}")])


def test_a_turn_that_was_asked_for_in_another_mode_is_refused() -> None:
    vehicle = SimulatedAutopilot("rover", seed=2, calibration="exact")
    vehicle.pilot_switches_mode("MANUAL")
    with pytest.raises(Refused, match="is in MANUAL"):
        checked(vehicle, "vehicle")


@pytest.mark.parametrize("roll", [0.0, 0.7])
def test_what_turns_all_along_shows_no_drift_of_its_gyro_and_the_field_of_any_moment(roll: float) -> None:
    vehicle = SimulatedAutopilot("rover", seed=2, calibration="exact")
    vehicle.turn_by_hand([HandMove(math.radians(90.0), 1.0, 0.0, sign * roll) for sign in (1.0, -1.0)] * 30)
    report = checked(vehicle, "none")
    assert verdicts(report, "stillness") == ["warn"] and verdicts(report, "gyro") == []
    assert verdicts(report, "field") == ["pass"]


def test_a_declination_that_is_set_by_hand_is_the_one_in_the_autopilots_yaw() -> None:
    by_hand = {"COMPASS_AUTODEC": 0.0, "COMPASS_DEC": 0.4}
    vehicle = SimulatedAutopilot("rover", seed=2, calibration="exact", parameters=by_hand)
    assert verdicts(checked(vehicle, "none"), "yaw") == ["pass"]


def test_the_check_changes_nothing_on_the_vehicle() -> None:
    vehicle = SimulatedAutopilot("rover", seed=3)
    before = [vehicle.firmware.compasses.correction(i) for i in (1, 2, 3)]
    checked(vehicle)
    assert [vehicle.firmware.compasses.correction(i) for i in (1, 2, 3)] == before


def test_a_copter_and_a_px4_vehicle_are_checked_too() -> None:
    for kind in ("copter", "px4-copter"):
        report = checked(SimulatedAutopilot(kind, seed=2, calibration="exact"), "none")
        assert verdicts(report, "field") == ["pass"], kind
        assert verdicts(report, "dip") == ["pass"], kind


@pytest.mark.parametrize(("dead", "found"), [("acc", ("level", "meter")), ("mag", ("data", "wiring"))])
def test_a_dead_sensor_is_what_fails_and_nothing_is_judged_by_it(dead: str, found: tuple[str, str]) -> None:
    vehicle = SimulatedAutopilot("rover", seed=2, calibration="exact")
    builders, offsets = vehicle.firmware.reports.builders, vehicle.firmware.compasses.correction(1).apply
    sound, at = builders[mav.RawImu], offsets(np.zeros(3)) if dead == "mag" else np.full(3, -32768)

    def at_its_end(time_us: int, share: float) -> mav.Message | None:
        told = sound(time_us, share)
        assert isinstance(told, mav.RawImu)
        return replace(told, **{f"{axis}{dead}": int(v) for axis, v in zip("xyz", at, strict=True)})

    builders[mav.RawImu] = at_its_end
    report = checked(vehicle)
    (wrong,) = (item for item in report.items if item.verdict == "fail")
    assert wrong.name == found[0] and found[1] in wrong.remedy
    assert report.turned is (dead == "mag") and not report.calibration_advised
    assert not [item for item in report.items if item.name in ("field", "dip") and item.instance == 1]


def test_a_sensor_that_is_not_there_is_blamed_for_nothing() -> None:
    # PX4 keeps the id of a sensor that is gone, and has no numbers for it.
    vehicle = SimulatedAutopilot("px4-copter", seed=2, calibration="exact")
    gone = {
        name: 0.0 for name in vehicle.firmware.store.values if name.startswith("CAL_MAG1_") and "OFF" in name
    }
    vehicle.firmware.store.values.update(gone)
    vehicle.firmware.reports.builders[mav.ScaledImu2] = lambda time_us, share: None
    report = checked(vehicle, "none")
    assert [item.text for item in report.items if item.instance == 2] == []
    assert any("CAL_MAG1_ID may hold the id of a sensor that is gone" in remark for remark in report.remarks)
    assert report.verdict == "pass", report.summary()


def test_px4_is_asked_what_it_has_against_arming() -> None:
    vehicle = SimulatedAutopilot("px4-copter", seed=2, calibration="exact", armed=False, ready_s=1.0)
    vehicle.advance(3.0)
    held = vehicle.firmware.store.values
    held.update(COM_ARM_MAG_ANG=5.0, CAL_MAG1_XOFF=held["CAL_MAG1_XOFF"] + 0.2)
    vehicle.firmware.compasses.parameters_changed()
    says = [item.text for item in checked(vehicle, "none").items if item.name == "prearm"]
    assert says == ['The autopilot says "Preflight Fail: Compasses inconsistent".']


def test_the_compass_at_fault_is_named_with_two_sound_ones_beside_it() -> None:
    sound = FieldCorrection((50.0, -30.0, 20.0))
    bent = FieldCorrection((150.0, 70.0, 20.0))
    setups = [CompassSetup(CompassModel(sound, 1.0), c) for c in (bent, sound, sound)]
    vehicle = SimulatedAutopilot("rover", seed=3, compasses=setups, start_yaw_deg=90.0)
    report = checked(vehicle, "none")
    (item,) = (item for item in report.items if item.name == "agreement")
    assert item.instance == 1 and item.verdict == "fail"
    assert item.text.startswith("Compass 1 is ") and "2 and 3, which agree" in item.text
    assert item.remedy.startswith("Calibrate compass 1;")


# --- the command ---------------------------------------------------------------------------------


def test_the_command_lists_what_is_wrong_and_says_so_to_scripts(tmp_path: Path) -> None:
    result = CliRunner().invoke(
        command, ["sim:rover,seed=3", "--json", str(tmp_path / "check.json")], standalone_mode=False
    )
    assert result.exception is None, result.exception
    assert result.return_value == 5
    lines = result.output.splitlines()
    assert lines[-2].startswith("FAIL  Not fit to drive: calibrate compass 1.")
    assert len(lines) <= 20, "readable in ten seconds"
    marks = [line.split()[0] for line in lines if line and not line.startswith(" ")]
    assert marks[:-2] == sorted(marks[:-2], key=["FAIL", "WARN", "PASS"].index)
    document = json.loads((tmp_path / "check.json").read_text())
    assert document["schema"] == "mavcompass.check/1"
    assert document["verdict"] == "fail"
    assert document["source"] == "sim:rover,seed=3"


def test_the_json_alone_goes_to_standard_output() -> None:
    result = CliRunner().invoke(
        command, ["sim:rover,seed=3", "--turn", "none", "--json", "-"], standalone_mode=False
    )
    assert json.loads(result.stdout)["turned"] is False


def test_preflight_keeps_its_report_and_passes_the_exit_code_on(tmp_path: Path) -> None:
    script = Path(__file__).parents[3] / "scripts" / "preflight"
    done = subprocess.run(
        [script, "sim:rover,seed=3"], cwd=tmp_path, stdin=subprocess.DEVNULL, capture_output=True, text=True
    )
    assert done.returncode == 5, done.stderr
    assert "Not fit to" in done.stdout
    reports = list((tmp_path / "preflight").glob("*.json"))
    assert len(reports) == 1
    assert json.loads(reports[0].read_text())["verdict"] == "fail"
