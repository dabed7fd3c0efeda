"""The autopilot's own calibration, run on simulated vehicles that a person turns: judged, written, ended."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from mavcompass.calibration.result import OwnFinding
from mavcompass.cli.main import main
from mavcompass.correction import FieldCorrection
from mavcompass.errors import PoorCalibration, Refused
from mavcompass.procedure.dialect import Overrides
from mavcompass.procedure.report import CalibrationReport
from mavcompass.procedure.script import Context, Machine, Script, Show
from mavcompass.procedure.settings import CalibrateSettings
from mavcompass.procedure.vehicle_state import find_vehicle
from mavcompass.simulation.heading_error import heading_error_rms_deg
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.vehicle.calibrating import calibrate_on
from mavcompass.vehicle.dialects import make_dialect
from mavcompass.vehicle.driver import run
from mavcompass.vehicle.links.simulated import SimulatedLink
from mavcompass.vehicle.parameters.undo import undo_saver
from mavcompass.vehicle.stopping import StopRequest

KINDS = ("rover", "px4-copter")


def on_the_bench(kind: str, **more: Any) -> SimulatedLink:
    return SimulatedLink.of(kind, seed=4, by_hand=True, **more)


def own(
    link: SimulatedLink,
    folder: Path,
    on_show: Callable[[Show], None] = lambda _: None,
    stop: StopRequest | None = None,
    **settings: Any,
) -> CalibrationReport:
    def show(what: Show) -> None:
        on_show(what)
        if link.person is not None:
            link.person(what)

    wanted = CalibrateSettings(**{"writing": "yes", "method": "autopilot", "rate_hz": 10.0, **settings})
    return calibrate_on(link, "sim:test", wanted, on_show=show, stop=stop, undo_directory=folder)


def values_of(link: SimulatedLink) -> dict[str, float]:
    vehicle = link.autopilot
    assert isinstance(vehicle, SimulatedAutopilot)
    held = vehicle.firmware.parameters.store.values
    return {n: v for n, v in held.items() if "COMPASS" in n or "CAL_MAG" in n}


@pytest.mark.parametrize("kind", KINDS)
def test_its_result_is_judged_by_ours_and_written_by_us(kind: str, tmp_path: Path) -> None:
    link = on_the_bench(kind)
    before = values_of(link)
    said = list[str]()
    report = own(link, tmp_path, lambda show: said.append(show.text), reboot=True)
    vehicle, result = link.autopilot, report.results[0]
    assert isinstance(vehicle, SimulatedAutopilot)
    assert report.written and report.proof is not None and report.proof.passed
    assert not any("--reboot" in message for message in report.messages)  # it was restarted
    assert result.method == "autopilot" and result.evidence[0].witness == "own-solution"
    assert not result.evidence[0].contradicts and result.evidence[0].difference_deg < 0.3
    assert heading_error_rms_deg(vehicle) < 0.3
    assert not vehicle.firmware.calibration.running  # type: ignore[attr-defined]
    assert report.outcome is not None and report.outcome.undo_file is not None
    assert any(text.startswith("Noting ") for text in said) is (kind == "px4-copter")
    # What leads back is the calibration before, not what the autopilot stored on the way.
    assert all(before[change.name] == pytest.approx(change.old) for change in report.plan.changes)  # type: ignore[union-attr]


@pytest.mark.parametrize("kind", KINDS)
def test_a_stop_cancels_it_in_the_autopilot_and_leaves_the_old_values(kind: str, tmp_path: Path) -> None:
    link, stop = on_the_bench(kind), StopRequest()
    before = values_of(link)

    def show(what: Show) -> None:
        if (what.fraction or 0.0) > 0.2:
            stop.reason = "Stopped by Ctrl-C."

    with pytest.raises(Refused, match=r"Stopped by Ctrl-C\..*Nothing written"):
        own(link, tmp_path, show, stop)
    assert not link.autopilot.firmware.calibration.running  # type: ignore[attr-defined]
    assert values_of(link) == before


def test_what_a_killed_run_left_with_px4_is_put_back_by_the_next(tmp_path: Path) -> None:
    link = on_the_bench("px4-copter")
    before, vehicle = values_of(link), link.autopilot
    assert isinstance(vehicle, SimulatedAutopilot)

    def record_and_die(context: Context) -> Script[None]:
        identity = yield from find_vehicle(context)
        dialect = make_dialect(identity.autopilot, "sim:test")
        parameters = yield from dialect.compass_parameters(context)
        overrides = Overrides(dialect, undo_saver("sim:test", tmp_path))
        yield from overrides.keep(context, dialect.changed_by_own(parameters))

    run(Machine(record_and_die), link)
    assert values_of(link) == before
    vehicle.firmware.parameters.store.set("CAL_MAG0_XOFF", 0.123)  # as PX4 stores its own, unjudged
    said: list[str] = []
    stop = StopRequest()

    def stops(what: Show) -> None:
        said.append(what.text)
        if what.step == "turn":
            stop.reason = "Enough."

    with pytest.raises(Refused):
        own(link, tmp_path, stops, stop)
    assert any("An earlier run was cut short" in text for text in said)
    assert values_of(link) == before and not list(tmp_path.glob("*.json"))


def test_a_vehicle_that_is_armed_is_refused(tmp_path: Path) -> None:
    with pytest.raises(Refused, match="armed"):
        own(SimulatedLink.of("rover", seed=4), tmp_path)


def test_a_result_that_its_own_readings_contradict_is_not_written_and_a_restart_is_said_to_be_wanted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from mavcompass.vehicle.dialects import ardupilot

    wrong = OwnFinding(FieldCorrection((300.0, 0.0, 0.0)))
    through = ardupilot.calibrate_ardupilot

    def bent(*args: Any) -> Any:
        found = yield from through(*args)
        return dict.fromkeys(found, wrong)

    monkeypatch.setattr(ardupilot, "calibrate_ardupilot", bent)
    link = on_the_bench("rover")
    before = values_of(link)
    report = own(link, tmp_path)
    assert not report.accepted and "from what its readings say by" in report.results[0].reasons[0]
    assert report.results[0].evidence[0].contradicts and values_of(link) == before
    assert not report.written and any("arms only after a restart" in said for said in report.messages)
    assert link.autopilot.firmware.calibration.reboot_wanted  # type: ignore[attr-defined]


def test_a_compass_whose_field_changes_fails_in_the_autopilot_and_is_refused(tmp_path: Path) -> None:
    link = on_the_bench("rover", effects=["noise_excess:sigma_mgauss=120"])
    with pytest.raises(PoorCalibration, match="The autopilot's own calibration failed"):
        own(link, tmp_path)


def test_what_px4_could_not_do_is_why_nothing_is_written(tmp_path: Path) -> None:
    link = on_the_bench("px4-copter")
    link.person = None  # nobody turns it
    before = values_of(link)
    with pytest.raises(PoorCalibration, match=r"requires rotation\.$"):
        own(link, tmp_path)
    assert values_of(link) == before


def test_from_a_recording_it_says_what_takes_its_place(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["calibrate", "sim:rover", "--dry-run", "--method", "autopilot", "--motion", "vehicle"]) == 2
    assert "wants a person" in capsys.readouterr().err
