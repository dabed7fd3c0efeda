"""The compass that keeps a vehicle from arming is the one to be calibrated: that check alone is set aside."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from bent_vehicles import bent_compasses, calibrated, overheard, perform

from mavcompass.errors import Refused
from mavcompass.messages import ParamSet
from mavcompass.procedure.dialect import Overrides
from mavcompass.procedure.motion import Permissions
from mavcompass.procedure.motion.readiness import arming_reasons
from mavcompass.procedure.script import Context, Script, nothing
from mavcompass.procedure.settings import CalibrateSettings
from mavcompass.procedure.vehicle_state import VehicleState
from mavcompass.simulation.heading_error import heading_error_rms_deg
from mavcompass.simulation.physics.noise import generator
from mavcompass.simulation.px4.flight import Arming
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.vehicle.dialects import make_dialect
from mavcompass.vehicle.parameters.undo import load_record, undo_saver

CALIBRATION = ("COMPASS_OFS_", "COMPASS_DIA_", "COMPASS_ODI_", "COMPASS_SCALE", "CAL_MAG0_", "STAT_")
ALL_BUT_THE_COMPASS = float(sum(1 << bit for bit in range(1, 21)) - 4)


def with_iron(kind: str, seed: int, mgauss: float) -> SimulatedAutopilot:
    """Make a vehicle on the ground whose first compass has iron beside it that nothing in force knows."""
    toward = float(generator(seed, "iron").uniform(0.0, 2.0 * math.pi))
    setups = bent_compasses(kind, seed, mgauss, toward)
    vehicle = SimulatedAutopilot(kind, seed=seed, compasses=setups, armed=False, ready_s=2.0)
    vehicle.advance(8.0)
    return vehicle


def settings(kind: str, exempt: str) -> CalibrateSettings:
    takeoff_m = 5.0 if kind.endswith("copter") else 0.0
    permissions = Permissions(set_mode=True, arm=True, takeoff_m=takeoff_m, exempt=exempt)  # type: ignore[arg-type]
    rate_hz = 10.0 if kind == "rover" else 25.0
    return CalibrateSettings(motion="vehicle", writing="yes", rate_hz=rate_hz, permissions=permissions)


@pytest.mark.parametrize("kind", ["rover", "copter", "px4-copter"])
def test_it_is_calibrated_in_one_go_and_all_but_the_calibration_is_as_before(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """PX4 though its estimator takes a while to settle on what it did not use before."""
    vehicle, since_s = with_iron(kind, 3, 300.0), list[float]()
    refuses = Arming.refusal

    def slowly(arming: Arming) -> str | None:
        if why := refuses(arming):
            return why
        since_s.append(vehicle.time_s)
        return None if vehicle.time_s > since_s[0] + 8.0 else "Preflight Fail: heading estimate not stable"

    monkeypatch.setattr(Arming, "refusal", slowly)
    before, off_deg = dict(vehicle.firmware.store.values), dict[str, float]()

    class Shown(list[str]):
        def append(self, text: str) -> None:
            super().append(text)
            off_deg[text] = heading_error_rms_deg(vehicle)

    shown = Shown()
    report = calibrated(vehicle, tmp_path, settings(kind, "yes"), shown=shown)
    assert off_deg["Turning to position 2 of 4."] > 45.0
    if kind == "rover":  # on the ground it does not turn on by a compass that is so far off
        assert off_deg["Turning to position 3 of 4."] < 15.0
    assert not kind.startswith("px4") or since_s[-1] > since_s[0] + 8.0
    assert any("with that check set aside" in text for text in shown), shown
    assert report.written and heading_error_rms_deg(vehicle) < 0.75
    after, armed = vehicle.firmware.store.values, vehicle.firmware.status.armed
    assert not armed
    assert [n for n in before if before[n] != after[n] and not n.startswith(CALIBRATION)] == []
    # What is left of it on the disk is the way back from the calibration; a copter's was saved while its
    # estimator was told to believe its compass, and leads back from that too.
    (record,) = tmp_path.glob("*.json")
    beside = {n: v for n, v in load_record(record).before.items() if not n.startswith(CALIBRATION)}
    assert "ARMING_CHECK" not in beside and beside == pytest.approx({n: after[n] for n in beside})


def test_what_else_forbids_arming_is_put_right_by_nobody(tmp_path: Path) -> None:
    vehicle = with_iron("rover", 3, 300.0)
    vehicle.firmware.calibration.start((1,), 580.0)  # type: ignore[attr-defined]
    before = dict(vehicle.firmware.store.values)
    with pytest.raises(Refused, match=r"refused to arm\. It said: Compass calibration running; Compasses"):
        calibrated(vehicle, tmp_path, settings("rover", "yes"))
    assert vehicle.firmware.store.values["ARMING_CHECK"] == before["ARMING_CHECK"]
    assert list(tmp_path.glob("*.json")) == []


@pytest.mark.parametrize(
    ("said", "held", "exempt"),
    [
        (["Arm: Check mag field (xy diff:130>100)"], {"ARMING_CHECK": 1.0}, ALL_BUT_THE_COMPASS),
        (["PreArm: Compasses inconsistent", "Arming"], {"ARMING_CHECK": 1.0}, ALL_BUT_THE_COMPASS),
        (["Arm: Compass not calibrated"], {"ARMING_CHECK": 20.0}, 16.0),
        (["Arm: Compass offsets too high"], {"ARMING_SKIPCHK": 2.0, "ARMING_CHECK": 1.0}, 6.0),
        (["Arm: Check mag field (z diff:250>200)", "Arm: Battery low"], {"ARMING_CHECK": 1.0}, None),
        (["Arm: Compass not healthy"], {"ARMING_CHECK": 1.0}, None),
        (["Arm: Compass calibrated requires reboot"], {"ARMING_CHECK": 1.0}, None),
        (["Arm: Check mag field: 900, max 875, min 185"], {}, None),
        ([], {"ARMING_CHECK": 1.0}, None),
    ],
)
def test_one_bit_is_set_aside_for_the_calibration_alone(
    said: Sequence[str], held: dict[str, float], exempt: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    dialect = make_dialect("ardupilot")
    told = lambda _, names: nothing({n: held[n] for n in names if n in held})  # noqa: E731
    monkeypatch.setattr(dialect, "read_parameters", told)
    with pytest.raises(StopIteration) as end:
        next(dialect.arming_exemption(Context(), arming_reasons(said)))
    assert list(end.value.value.values()) == ([] if exempt is None else [exempt])


@pytest.mark.parametrize(
    ("said", "values"),
    [
        (["Preflight Fail: Compasses 74° inconsistent"], {"COM_ARM_MAG_ANG": -1.0}),
        (["Preflight Fail: Strong magnetic interference"], {"EKF2_MAG_CHECK": 0.0}),
        (["Preflight Fail: Compasses inconsistent", "Preflight Fail: ekf2 missing data"], {}),
        (["Preflight Fail: Compass 0 uncalibrated"], {}),
        (["Arming denied: Resolve system health failures first"], {}),
    ],
)
def test_px4_has_a_parameter_for_some_of_it(said: Sequence[str], values: dict[str, float]) -> None:
    with pytest.raises(StopIteration) as end:
        next(make_dialect("px4").arming_exemption(Context(), arming_reasons(said)))
    assert end.value.value == values


def test_what_a_quarter_turn_has_shown_is_not_put_in_force_where_nothing_is_to_be_written(
    tmp_path: Path,
) -> None:
    vehicle = with_iron("rover", 3, 300.0)
    heard = overheard(vehicle)
    assert calibrated(vehicle, tmp_path, replace(settings("rover", "yes"), writing="never")).accepted
    assert not [m for m in heard if isinstance(m, ParamSet) and m.param_id.startswith(CALIBRATION)]


def test_what_a_killed_run_has_left_is_put_back_by_the_next(tmp_path: Path) -> None:
    vehicle = with_iron("rover", 3, 300.0)

    def hold_and_die(context: Context, state: VehicleState) -> Script[bool]:
        overrides = Overrides(make_dialect("ardupilot", "sim:test"), undo_saver("sim:test", tmp_path))
        return (yield from overrides.hold(context, {"ARMING_CHECK": ALL_BUT_THE_COMPASS}))

    assert perform(vehicle, hold_and_die)
    (record,) = tmp_path.glob("*.json")
    assert load_record(record).before == {"ARMING_CHECK": 1.0} and load_record(record).for_now
    shown: list[str] = []
    with pytest.raises(Refused, match="refused to arm"):
        calibrated(vehicle, tmp_path, settings("rover", "never"), shown=shown)
    assert "An earlier run was cut short: ARMING_CHECK is put back." in shown
    assert vehicle.firmware.store.values["ARMING_CHECK"] == 1.0
    assert list(tmp_path.glob("*.json")) == []
