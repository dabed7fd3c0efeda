"""The files of params/: complete, consistent with the code, and true of the firmware they are for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from parameter_vehicle import ardupilot_parameters

from mavcompass.errors import MavCompassError
from mavcompass.installation.parts import params_path
from mavcompass.procedure.motion.safety import MOST_RADPS
from mavcompass.procedure.turning import profiles as vehicle_profiles
from mavcompass.procedure.turning import strategies_for, vehicle_profile
from mavcompass.vehicle.dialects import make_dialect
from mavcompass.vehicle.parameters import rules as parameter_rules
from mavcompass.vehicle.parameters.files import read_parameter_file

FAULTS = sorted(params_path("sitl-faults").glob("*.parm"))


@pytest.mark.parametrize("path", FAULTS, ids=lambda path: path.stem)
def test_a_fault_preset_loads_and_explains_itself(path: Path) -> None:
    values = read_parameter_file(path)
    assert path.read_text().startswith("# ")
    for stem in ("SIM_MAG1_DIA", "SIM_MAG2_DIA", "SIM_MAG3_DIA", "SIM_MAG1_OFS"):
        # The simulator takes a matrix of which only one axis is set for singular and leaves it out.
        assert sum(f"{stem}_{axis}" in values for axis in "XYZ") in (0, 3)


def test_none_takes_every_other_preset_back() -> None:
    none = read_parameter_file(params_path("sitl-faults/none.parm"))
    others = {name for path in FAULTS for name in read_parameter_file(path) if name.startswith("SIM_")}
    assert others <= set(none)


def test_the_firmwares_simulator_knows_every_name(shared_data: Path) -> None:
    from mavcompass import read_track

    known = read_track(str(shared_data / "ardupilot-4.6.3" / "rover_plain.BIN")).parameters
    names = {name for path in FAULTS for name in read_parameter_file(path)}
    assert not names - set(known)
    defaults = read_parameter_file(params_path("sitl-faults/none.parm"))
    assert defaults == {name: known[name] for name in defaults}


@pytest.mark.parametrize("name", ["mild", "strong", "severe"])
def test_the_exact_cure_of_a_fault_may_be_written(name: str) -> None:
    fault = read_parameter_file(params_path(f"sitl-faults/{name}.parm"))
    cure = {n.replace("SIM_MAG1_", "COMPASS_"): v for n, v in fault.items() if n.startswith("SIM_MAG1_")}
    dialect = make_dialect("ardupilot")
    plan = dialect.plan_values(ardupilot_parameters(), cure)
    assert plan.changes and not plan.refusals
    correction = dialect.correction(ardupilot_parameters() | cure, 1)
    # raw = E^-1 truth - OFS is what the simulator's compass reads
    truth = np.array([232.0, 52.7, -528.9])
    raw = np.linalg.solve(correction.matrix, truth) - correction.offsets_mgauss
    assert correction.apply(raw) == pytest.approx(truth)


@pytest.mark.parametrize(
    ("kind", "ackermann", "name"),
    [("rover", False, "rover"), ("rover", True, "ackermann-rover"), ("boat", False, "boat"),
     ("boat", True, "steered-boat"), ("copter", False, "copter"), ("sub", False, "sub")],
)  # fmt: skip
def test_every_vehicle_that_can_turn_itself_has_its_profile(kind: str, ackermann: bool, name: str) -> None:
    ways = strategies_for(kind, "ardupilot", ackermann)
    profile = vehicle_profile(kind, "ardupilot", ackermann)
    assert profile is not None
    assert profile.name == name
    # What the procedure turns by is what the file says.
    assert ways and tuple(turn.way for turn in ways) == profile.ways
    # A turn at the profile's rate is well inside the limit.
    assert all(way.rate_radps < 0.5 * MOST_RADPS for way in profile.ways)


def test_a_way_that_does_not_exist_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    profile = vehicle_profiles.VehicleProfile(
        "tank", "ardupilot", ("rover",), (vehicle_profiles.TurnWay("tracks", 1.0),)
    )
    monkeypatch.setattr(vehicle_profiles, "vehicle_profiles", lambda: (profile,))
    with pytest.raises(MavCompassError, match="'tracks'"):
        strategies_for("rover", "ardupilot")


def test_profiles_are_told_apart_by_autopilot_and_kind() -> None:
    keys = [(p.autopilot, kind) for p in vehicle_profiles.vehicle_profiles() for kind in p.kinds]
    assert len(set(keys)) == len(keys)
    px4 = vehicle_profile("copter", "px4")
    assert px4 is not None and px4.name == "px4-copter"


def test_what_only_a_person_can_turn_has_no_profile() -> None:
    assert vehicle_profile("plane", "ardupilot") is None
    assert vehicle_profile("unknown", "px4") is None


@pytest.mark.parametrize(
    "damage",
    ["[read", "[read]\ngeneral = []\n", "[offset]\nusual_mgauss = 'many'\n"],
)
def test_a_damaged_rules_file_is_named(damage: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "ardupilot.toml").write_text(damage)
    monkeypatch.setattr(parameter_rules, "params_path", lambda name: tmp_path / name)
    with pytest.raises(MavCompassError, match=r"ardupilot\.toml cannot be used"):
        parameter_rules.parameter_rules.__wrapped__("ardupilot")


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("rate_deg_s = ", "rate_deg_s = -"),
        ("[[turn]]", "[[tern]]"),
        ("coast_s", "cost_s"),
        ("kinds", "kinds = 3 #"),
    ],
)
def test_a_damaged_profile_is_named(
    old: str, new: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "vehicles").mkdir()
    whole = params_path("vehicles/rover.toml").read_text()
    (tmp_path / "vehicles" / "tank.toml").write_text(whole.replace(old, new))
    monkeypatch.setattr(vehicle_profiles, "params_path", lambda name: tmp_path / name)
    with pytest.raises(MavCompassError, match=r"tank\.toml cannot be used"):
        vehicle_profiles.vehicle_profiles.__wrapped__()


def test_the_rules_agree_with_what_the_firmware_applies() -> None:
    from mavcompass.compass_parameters import ARDUPILOT_SCALE_LIMITS

    rules = parameter_rules.parameter_rules("ardupilot")
    assert rules.scale == pytest.approx(ARDUPILOT_SCALE_LIMITS, abs=1e-6)
    assert rules.diagonal[0] < 1.0 < rules.diagonal[1]
